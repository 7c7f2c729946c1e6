"""What the explorer shows is what `tvsysid identify` finds with the command that it shows."""

import asyncio
import os
import shlex
import sys
from pathlib import Path

import attrs
import numpy as np
import pandas as pd
import pytest
from tests import faults

import tvsysid as tv
from tvsysid.explorer import outcome as steps
from tvsysid.explorer.outcome import outcome
from tvsysid.explorer.settings import (
    Settings,
    method_parts,
    method_settings,
    method_text,
    settings_from,
)
from tvsysid.recordings import Reading, Segmentation

CUTTING = Segmentation(period=2.0, decimate=100.0)

SAID = {
    "angle": "pos",
    "torque": "tq",
    "sampling_rate": 1000.0,
    "angle_unit": "deg",
    "torque_unit": "Nm",
    "columns": "contiguous",
    "reversed": True,
    "period": 2.0,
    "decimate": 100.0,
    "context": 0.25,
    "align_channels": True,
    "method": "sds",
    "settings": {"window": "0.2", "max_lag": "", "reference": "command"},
}


@pytest.fixture(scope="module")
def recording():
    joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
    return joint.simulate(
        40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1, rate=1000
    ).recording


@pytest.fixture(scope="module")
def file(recording, tmp_path_factory):
    """In degrees, with the torque reversed and 12 ms late."""
    file = tmp_path_factory.mktemp("explored") / "my ankle.npz"
    torque = -np.roll(recording.torque, 12)
    np.savez(
        file, pos=np.degrees(recording.angle), tq=torque, cmd=np.roll(recording.angle, -3), one=1.0
    )
    return file


def start(file):
    return Settings(file, Reading(channels={"command": "cmd"}))


@pytest.fixture(scope="module")
def found(file):
    return outcome(settings_from(SAID, start(file)))


@pytest.mark.slow
def test_the_command_shown_finds_the_same(found, tvsysid, monkeypatch):
    # Stop after the table is written
    monkeypatch.setattr("tvsysid.report.folder.write_identification", lambda *given: sys.exit(0))
    code, _, _ = tvsysid(*shlex.split(found.settings.command)[1:], "--out", "found")
    assert code == 0
    written, shown = pd.read_csv("found/stiffness.csv"), found.found.over_time()
    assert list(written.method.unique()) == ["sds:window=0.2,reference=command"]
    for name in ("stiffness", "stiffness_lower", "inertia", "time_varying_vaf"):
        np.testing.assert_allclose(written[name], shown[name], rtol=1e-5)


def test_the_python_shown_finds_the_same(found):
    names: dict = {}
    exec(found.settings.python(found.prepared), names)
    (model,) = names["found"].models.values()
    np.testing.assert_array_equal(
        model.stiffness, found.found.models[found.settings.method].stiffness
    )
    assert found.prepared.ensemble.delay_removed == pytest.approx(0.012, abs=0.0005)


def test_a_recording_needs_no_file(recording):
    settings = Settings(recording, cutting=CUTTING, method="esm")
    found, names = outcome(settings), {"recording": recording}
    assert settings.command == ""
    exec(settings.python(found.prepared), names)
    np.testing.assert_array_equal(
        names["found"].models["esm"].stiffness, found.found.models["esm"].stiffness
    )


def test_gaps_and_mains_are_taken_out_as_identify_does(recording):
    spoilt = faults.gapped(faults.humming(recording), count=2)
    settings = Settings(spoilt, cutting=CUTTING, method="esm")
    found, names = outcome(settings), {"recording": spoilt}
    assert (found.prepared.mains, len(found.notes)) == (50.0, 2)
    exec(found.settings.python(found.prepared), names)
    np.testing.assert_array_equal(
        names["found"].models["esm"].stiffness, found.found.models["esm"].stiffness
    )
    assert (
        len(found.prepared.ensemble)
        == len(outcome(Settings(recording, cutting=CUTTING, method="esm")).prepared.ensemble) - 4
    )


def test_only_what_changes_is_done_anew(found, monkeypatch):
    def nobody(*given, **words):
        raise AssertionError("done anew")

    found = outcome(found.settings)  # other tests may have filled the caches meanwhile
    monkeypatch.setattr(steps, "read_recording", nobody)
    again = attrs.evolve(found.settings, method="esm")
    assert outcome(again).found is outcome(again).found
    monkeypatch.setattr(steps, "compare", nobody)
    assert outcome(found.settings).found is found.found
    os.utime(found.settings.source, ns=(1, 1))  # a file that has changed is read again
    with pytest.raises(AssertionError, match="done anew"):
        outcome(found.settings)


def test_what_was_chosen_meanwhile_is_not_begun():
    done = []

    async def chosen():
        with steps.ONE_AT_A_TIME:
            choices = [
                asyncio.ensure_future(steps.in_turn(done.append, number)) for number in range(3)
            ]
            await asyncio.sleep(2 * steps.POLL_S)
            for each in choices[:2]:
                each.cancel()
        await choices[2]

    asyncio.run(chosen())
    assert done == [2]


@pytest.mark.slow
def test_an_outcome_in_words_and_in_a_picture(found):
    assert found.lines[0].startswith("sds:window=0.2,reference=command: stiffness ")
    assert found.diagnosis.verdict
    pictures = {
        outcome(found.settings, *choice).picture
        for choice in (("stiffness",), ("inertia",), ("stiffness", True))
    }
    assert all(each.lstrip().startswith(b"<?xml") for each in pictures)
    assert len(pictures) == 3


def test_an_outcome_that_cannot_be_right_states_no_stiffness(file):
    found = outcome(settings_from(SAID | {"reversed": False}, start(file)))
    assert found.lines[0].startswith("no stiffness is stated. No joint has a negative stiffness.")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"angle": ""}, "choose the channel with the angle"),
        ({"sampling_rate": None}, "enter the sampling rate"),
        ({"period": None}, "enter the duration of one repetition"),
        ({"period": float("inf")}, "period"),
        ({"period": 300.0}, "300 s"),
        ({"torque": "pos"}, "angle and torque are both 'pos'"),
        ({"torque": "one"}, "different lengths"),
        ({"settings": {"window": "wide"}}, "window must be"),
    ],
)
def test_what_is_wrong_is_an_input_error(file, changed, message):
    with pytest.raises(tv.InputError, match=message):
        outcome(settings_from(SAID | changed, start(file)))


def test_a_command_has_what_differs_from_the_defaults():
    reading = Reading(angle="1", torque="2", sampling_rate=500, start=-0.5, channels={"emg": "3"})
    settings = Settings(Path("a.csv"), reading, Segmentation(period=1.5), align_channels=False)
    assert settings.command == (
        "tvsysid identify a.csv --angle 1 --torque 2 --rate 500 --channel emg=3 "
        "--start -0.5 --period 1.5 --no-align-channels --method adaptive"
    )


@pytest.mark.parametrize("key", tv.methods.METHODS)
def test_settings_are_shown_as_they_are_typed(key):
    usual = {name: text for name, text in method_settings(key).items() if text != "None"}
    made, same = tv.methods.parse(method_text(key, usual)), tv.methods.parse(key)
    close = {
        name: pytest.approx(value, rel=1e-3)
        for name, value in vars(same).items()
        if isinstance(value, float)
    }
    assert vars(made) == vars(same) | close
    assert method_parts(method_text(key, usual)) == (key, usual)


def test_the_page_is_built(file, recording):
    pytest.importorskip("shiny")
    from tvsysid.explorer.page import page

    shown = Settings(file, Reading(angle="pos"), method="birf:basis=HaarWavelets(functions=8)")
    html = page(shown, {"pos": "pos (10)"}).ui["html"]
    assert 'value="HaarWavelets(functions=8)"' in html
    assert '<option value="pos" selected="">' in html
    assert 'id="angle"' not in page(Settings(recording), {}).ui["html"]


def test_a_picture_in_words(found):
    pytest.importorskip("shiny")
    from tvsysid.explorer.page import _figure, judged, numbers

    assert "inertia over a realization" in str(_figure(found, "inertia"))
    assert "reflex gain is not identified by this method" in str(_figure(found, "reflex_gain"))
    assert "stiffness (N·m/rad)" in str(numbers(found))
    assert "Method for these data" in str(judged(found))


def test_without_the_library_it_says_how_to_install_it(monkeypatch, file, tvsysid):
    monkeypatch.setitem(sys.modules, "shiny", None)
    monkeypatch.delitem(sys.modules, "tvsysid.explorer.page", raising=False)
    code, out, errors = tvsysid("explore", file)
    assert (code, out) == (2, "")
    assert errors == "tvsysid: the explorer needs Shiny: pip install 'tvsysid[explore]'\n"


def test_an_explorer_refuses_what_is_wrong_before_it_opens(file, recording, tmp_path):
    pytest.importorskip("shiny")
    for given, message in (
        ({"angle": "position"}, "no channel 'position'; the file holds pos, tq, cmd"),
        ({"channels": {"command": "CMD"}}, "no channel 'CMD'; the file holds pos, tq, cmd"),
        ({"angle_unit": "grad"}, "angle_unit"),
        ({"period": "2 s"}, "period"),
        ({"port": 70000}, "port 70000: expected a whole number from 0 to 65535"),
    ):
        with pytest.raises(tv.InputError, match=message):
            tv.explore(file, **given)
    with pytest.raises(tv.InputError, match="has been read already; leave out sampling_rate"):
        tv.explore(recording, sampling_rate=1000)
    with pytest.raises(tv.InputError, match="unknown method 'sd'"):
        tv.explore(file, method="sd:window=0.2")
    with pytest.raises(tv.InputError, match=r"none\.mat"):
        tv.explore(tmp_path / "none.mat")


def test_a_page_is_at_a_secret_address_of_this_computer_alone(recording):
    pytest.importorskip("shiny")
    from urllib.error import HTTPError
    from urllib.request import urlopen

    running = tv.explore(recording, period=2.0)
    try:
        base, secret = running.url.rstrip("/").rsplit("/", 1)
        assert base.startswith("http://127.0.0.1:")
        assert len(secret) >= 16
        assert b"Realizations" in urlopen(running.url).read()
        with pytest.raises(HTTPError, match="404"):
            urlopen(f"{base}/")
        with pytest.raises(tv.InputError, match="give another"):
            tv.explore(recording, port=int(base.rsplit(":", 1)[1]))
    finally:
        running.close()
    with pytest.raises(OSError, match="refused"):
        urlopen(running.url)
    assert not steps._found.cache_info().currsize  # no recording is kept in memory
