"""Damaged files are read or refused: they never end or hang the process that reads them.

After a change to a reader, or a new version of a library beneath, try other and more files:

    TVSYSID_FUZZ_SEED=1 TVSYSID_FUZZ_COUNT=10000 pytest -n0 tests/recordings/test_fuzz.py

It reports the seed and number of each file that ends in another error than InputError, stops the
reading process, prints, or takes more than 8 GiB. Copy such a file to ``found`` when it is mended.
"""

import os
import sys
from pathlib import Path

import pytest
from tests.recordings.fuzzing import SEEDS, Reader, attack, sound_files

SEED = int(os.environ.get("TVSYSID_FUZZ_SEED", "5"))
COUNT = int(os.environ.get("TVSYSID_FUZZ_COUNT", "300"))
FOUND = sorted(Path(__file__).with_name("found").iterdir())  # mutants that did what their names say
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the limits are those of Linux")


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    reader = Reader(tmp_path_factory.mktemp("reader"))
    yield reader
    reader.end()


@pytest.mark.slow
def test_damage_is_read_or_refused(tmp_path, reader):
    sound = sound_files(tmp_path)
    assert {name: reader.read(tmp_path / name)[1] for name in SEEDS} == {name: [] for name in SEEDS}
    outcomes = list(attack(tmp_path, sound, reader, SEED, range(COUNT)))
    assert {count > 0 for _, count, _ in outcomes} == {True, False}
    assert [each for _, _, wrong in outcomes for each in wrong] == []


@pytest.mark.slow
def test_what_once_did_harm_is_read_or_refused(reader):
    assert {file.name: reader.read(file)[1] for file in FOUND} == {file.name: [] for file in FOUND}
