"""What the explorer shows is what `tvsysid identify` finds with the command that it shows."""

import os
import shlex
from pathlib import Path
from threading import Thread
from urllib.error import HTTPError
from urllib.parse import urlencode
from urllib.request import urlopen

import attrs
import numpy as np
import pytest
import xarray as xr
from tests import faults

import tvsysid as tv
from tvsysid.explorer import outcome as steps
from tvsysid.explorer.outcome import outcome
from tvsysid.explorer.page import page, result, shown
from tvsysid.explorer.settings import Settings, method_settings, method_text, settings_from
from tvsysid.methods.settings import split_settings
from tvsysid.recordings import Reading, Segmentation, describe_file
from tvsysid.recordings.channel import channel_of
from tvsysid.recordings.saved import saved_settings, settings_file
from tvsysid.report.experiment import _answer_for
from tvsysid.report.page import in_text
from tvsysid.report.sheet import facts
from tvsysid.study import Experiment, prepared_recordings

CUTTING = Segmentation(period=2.0, decimate=100.0)

FORM = {
    "angle": "pos",
    "torque": "tq",
    "sampling_rate": "1000",
    "angle_unit": "deg",
    "torque_unit": "Nm",
    "columns": "contiguous",
    "reversed": "on",
    "period": "2",
    "decimate": "100",
    "context": "0.25",
    "align_channels": "on",
    "method": "birf",
    "birf.max_lag": "0.2",
    "birf.prior": "",
    "birf.reference": "command",
    "kbr.lags": "3",
    "quantity": "stiffness",
    "band": "pointwise",
}


@pytest.fixture(scope="module")
def recording():
    return faults.simulated(40.0)


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
    return outcome(settings_from(FORM, start(file)))


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_page_command_sheet_and_python_give_one_answer(file, tvsysid, found):
    answer, names = found.found.answer, {}
    exec(found.settings.python, names)
    assert repr(names["found"]) == repr(found.found)
    np.testing.assert_array_equal(names["found"].answer.stiffness, answer.stiffness)
    command = shlex.split(found.settings.command)[1:]
    code, out, _ = tvsysid(*command, "--sheet", "--out", "found")
    assert code == 0
    assert repr(found.found) in out
    with xr.open_datatree("found/models.nc", engine="h5netcdf") as tree:
        assert tree.attrs.items() >= facts(found.found, file.name).items()  # of the sheet
        np.testing.assert_array_equal(tree[tree.leading].stiffness, answer.stiffness)
    assert found.prepared.ensemble.delay_removed == pytest.approx(0.012, abs=0.0005)


STUDY = """
participants.P1.noise = "joint.npz"
reading = {angle = "angle", torque = "torque", sampling_rate = 1000}

[preparation]
period = 2
rate = 100
ends = 0
reference = false
task_limit = false
residual_limit = false
"""


@pytest.mark.slow
@pytest.mark.parametrize("is_faulty", [False, True])
@pytest.mark.usefixtures("undrawn")
def test_an_experiment_gives_the_same_answer_by_default(recording, tvsysid, is_faulty):
    if is_faulty:  # gaps, mains hum, and a delay of 5 ms
        late = faults.changed(recording, torque=np.roll(recording.torque, 5))
        recording = faults.humming(faults.gapped(late, count=2))
    np.savez("joint.npz", angle=recording.angle, torque=recording.torque)
    Path("study.toml").write_text(STUDY)
    reading = Reading(angle="angle", torque="torque", sampling_rate=1000)
    settings = Settings(Path("joint.npz"), reading, CUTTING)
    shown = outcome(settings)
    found = shown.found
    assert repr(found) in tvsysid(*shlex.split(settings.command)[1:])[1]
    (prepared,) = prepared_recordings(Experiment.from_toml("study.toml"))
    assert [*prepared.remarks] == [
        each for each in map(str, shown.prepared.corrections) if "gaps" not in each
    ]
    assert len(prepared.remarks) == 2 * is_faulty
    again = tv.compare(prepared.ensemble)
    assert repr(again) == repr(found)
    np.testing.assert_array_equal(again.answer.stiffness, found.answer.stiffness)
    words = in_text(found.answer.stiffness.mean(), found.answer.half_band, 1)
    stated = _answer_for(prepared, [])
    assert stated[1:4] == (words, "adaptive", " ".join(found.answer.reasons))


def test_the_python_shown_of_a_recording_without_a_file(recording):
    spoilt = faults.gapped(faults.humming(recording), count=2)
    found = outcome(Settings(spoilt, cutting=CUTTING, method="esm"))
    assert len(found.notes) == 2
    assert found.settings.command == ""
    names: dict = {"recording": spoilt}
    exec(found.settings.python, names)
    assert repr(names["found"]) == repr(found.found)


def test_only_what_changes_is_done_anew(found, monkeypatch):
    def nobody(*given, **words):
        raise AssertionError("done anew")

    found = outcome(found.settings)  # other tests may have filled the caches meanwhile
    monkeypatch.setattr(steps, "prepare", nobody)
    again = attrs.evolve(found.settings, method="birf:max_lag=0.3,reference=command")
    assert outcome(again).found is outcome(again).found
    monkeypatch.setattr(steps, "compare", nobody)
    assert outcome(found.settings).found is found.found
    os.utime(found.settings.source, ns=(1, 1))  # a file that has changed is read again
    with pytest.raises(AssertionError, match="done anew"):
        outcome(found.settings)


def test_an_outcome_that_cannot_be_right_states_no_stiffness(file):
    form = {name: text for name, text in FORM.items() if name != "reversed"}
    lines = outcome(settings_from(form, start(file))).found.answer.lines
    assert lines[0].startswith("no stiffness is stated. The torque has the opposite sign: ")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"angle": ""}, "choose the channel with the angle"),
        ({"sampling_rate": ""}, "enter the sampling rate"),
        ({"period": ""}, "enter the duration of one repetition"),
        ({"period": "inf"}, "period must be"),
        ({"period": "300"}, "300 s"),
        ({"torque": "pos"}, "angle and torque are both &#39;pos&#39;"),
        ({"torque": "one"}, "different lengths"),
        ({"birf.max_lag": "wide"}, "max_lag must be"),
    ],
)
def test_what_is_wrong_is_said_on_the_page(file, changed, message):
    html = result(FORM | changed, start(file))
    assert '<p class="alert alert-danger">' in html
    assert message in html


def test_a_command_has_what_differs_from_the_defaults():
    reading = Reading(angle="1", torque="2", sampling_rate=500, start=-0.5, channels={"emg": "3"})
    settings = Settings(Path("a.csv"), reading, Segmentation(period=1.5), align_channels=False)
    assert settings.command == (
        "tvsysid identify a.csv --angle 1 --torque 2 --rate 500 --channel emg=3 "
        "--start -0.5 --period 1.5 --no-align-channels"
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
    assert split_settings(method_text(key, usual)[len(key) + 1 :]) == usual


def test_the_page_is_built(file, recording):
    settings = Settings(file, Reading(angle="pos"), method="birf:basis=HaarWavelets(functions=8)")
    html = page(settings, {"pos": channel_of(np.array([0, 3, 1, np.nan]), "deg")})
    assert 'value="HaarWavelets(functions=8)"' in html
    assert '<option value="pos" selected>pos (4, deg)' in html
    assert 'points="0,1 0.1429,1 0.2857,0 0.4286,0 0.5714,0.6667 0.7143,0.6667"' in html
    assert 'id="angle"' not in page(Settings(recording), {})


@pytest.mark.slow
def test_an_outcome_in_words_in_a_picture_and_in_numbers(found):
    html = shown(found)
    assert "<p>birf:max_lag=0.2,reference=command: stiffness " in html
    assert "stiffness over a realization" in html
    assert "stiffness (N·m/rad)" in html
    assert "reflex gain is not identified by this method" in shown(found, "reflex_gain")
    pictures = {
        outcome(found.settings, *choice).picture
        for choice in (("stiffness",), ("inertia",), ("stiffness", True))
    }
    assert all(each.lstrip().startswith(b"<?xml") for each in pictures)
    assert len(pictures) == 3


def test_settings_are_saved_beside_the_file(file):
    assert "my ankle.npz.toml" in page(start(file), describe_file(file))
    result(FORM | {"save": "on"}, start(file))
    saved, settings = saved_settings(file), settings_from(FORM, start(file))
    assert saved == attrs.asdict(settings.reading) | attrs.asdict(settings.cutting)
    settings_file(file).unlink()


def test_an_explorer_refuses_what_is_wrong_before_it_opens(file, recording, tmp_path):
    for given, message in (
        ({"angle_unit": "grad"}, "angle_unit must be"),
        ({"period": "2 s"}, "period must be"),
        ({"port": 70000}, "port 70000: bind..: port must be 0-65535.; give another"),
    ):
        with pytest.raises(tv.InputError, match=message):
            tv.explore(file, **given)
    with pytest.raises(tv.InputError, match="has been read; leave out the settings for reading"):
        tv.explore(recording, sampling_rate=1000)
    with pytest.raises(tv.InputError, match="unknown method 'sd'"):
        tv.explore(file, method="sd:window=0.2")
    with pytest.raises(tv.InputError, match=r"none\.mat"):
        tv.explore(tmp_path / "none.mat")


def test_a_page_is_at_a_secret_address_of_this_computer_alone(recording):
    running = tv.explore(recording, period=2.0)
    form = urlencode(FORM | {"method": "esm"}).encode()
    try:
        base, secret = running.url.rstrip("/").rsplit("/", 1)
        assert base.startswith("http://127.0.0.1:")
        assert len(secret) >= 16
        assert b"Realizations" in urlopen(running.url).read()
        assert b"esm: stiffness" in urlopen(running.url, form).read()
        with pytest.raises(HTTPError, match="404"):
            urlopen(f"{base}/")
        with pytest.raises(HTTPError, match="404"):
            urlopen(f"{base}/", form)
        with pytest.raises(tv.InputError, match="give another"):
            tv.explore(recording, port=int(base.rsplit(":", 1)[1]))
    finally:
        running.close()
    with pytest.raises(OSError, match="refused"):
        urlopen(running.url)
    assert not steps._identify.cache_info().currsize  # no recording is kept in memory


def test_what_was_chosen_meanwhile_is_not_begun(recording, monkeypatch):
    done = []
    monkeypatch.setattr(
        "tvsysid.explorer.serving.result", lambda form, start: done.append(form["period"]) or ""
    )
    running = tv.explore(recording, period=2.0)
    try:
        with steps.ONE_AT_A_TIME:
            asked = []
            for period in "123":
                body = urlencode({"period": period}).encode()
                asked.append(Thread(target=urlopen, args=(running.url, body)))
                asked[-1].start()
                asked[-1].join(0.1)
        for each in asked:
            each.join()
    finally:
        running.close()
    assert done == ["3"]
