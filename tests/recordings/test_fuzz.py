"""Damaged files are read or refused.

They never end, hang or fill the process that reads them (`fuzzing.py`).
"""

import sys
from pathlib import Path

import h5py
import pytest
from tests.recordings.fuzzing import attack, mutant, reader_of, sound_files
from tests.recordings.mutations import lookup3, with_checksums

SEED, COUNT = 5, 300
FOUND = sorted(Path(__file__).with_name("found").iterdir())  # mutants that did what their names say
limited = pytest.mark.skipif(
    sys.platform != "linux", reason="limits and peaks of memory are read as Linux tells them"
)


def test_mutants_follow_from_their_number(tmp_path):
    sound = sound_files(tmp_path)
    mutants = [mutant(sound, SEED, number) for number in range(48)]
    assert mutants == [mutant(sound, SEED, number) for number in range(48)]
    assert sum(content != sound[name] for name, content in mutants) > 40


def test_checksums_are_those_of_hdf5(tmp_path):
    assert lookup3(b"Four score and seven years ago") == 0x17770551
    for name, content in sound_files(tmp_path).items():
        assert with_checksums(content) == content, name
    content = (tmp_path / "ankle.nc").read_bytes().replace(b"coarse", b"roughs")
    (tmp_path / "wrong.h5").write_bytes(content)
    with (
        h5py.File(tmp_path / "wrong.h5") as root,
        pytest.raises(Exception, match="incorrect metadata checksum"),
    ):
        list(root)
    (tmp_path / "right.h5").write_bytes(with_checksums(content))
    with h5py.File(tmp_path / "right.h5") as root:
        assert "roughs" in root


@pytest.fixture(scope="module")
def sound_and_reader(tmp_path_factory):
    with reader_of(tmp_path_factory.mktemp("sound")) as both:
        yield both


@limited
@pytest.mark.slow
def test_damage_is_read_or_refused(tmp_path, sound_and_reader):
    outcomes = list(attack(tmp_path, *sound_and_reader, SEED, range(COUNT)))
    assert len(outcomes) == COUNT
    assert {outcome.name for outcome in outcomes if outcome.read} == set(sound_and_reader[0])
    assert {outcome.name for outcome in outcomes if not outcome.read} == set(sound_and_reader[0])
    assert {
        f"{item.name}, seed {SEED}, number {item.number}": item.wrong
        for item in outcomes
        if item.wrong
    } == {}


@limited
@pytest.mark.slow
def test_what_once_did_harm_is_read_or_refused(sound_and_reader):
    _, reader = sound_and_reader
    assert {file.name: reader.read(file)["wrong"] for file in FOUND} == {
        file.name: [] for file in FOUND
    }
