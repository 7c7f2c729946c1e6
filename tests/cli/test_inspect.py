"""`tvsysid inspect`."""

import numpy as np
import pytest
from scipy.io import savemat
from tests.cli.conftest import IDENTIFY, rows_of, text_of

import tvsysid as tv
from tvsysid.cli.options import rate_options


@pytest.mark.slow
def test_inspect_lists_and_draws(tvsysid, tmp_path):
    tvsysid("simulate joint.mat --duration 4")
    code, out, err = tvsysid("inspect joint.mat")
    assert (code, err) == (0, "")
    assert ["angle", "4000 x 1, 1000 Hz"] in rows_of(out)
    assert ["sampling_rate", "1 x 1"] in rows_of(out)
    assert "wrote tvsysid-inspect/joint.mat.png" in out
    options = "--angle angle --torque torque --rate 1000 --decimate 100 --period SECONDS"
    assert f"identify it with\ntvsysid identify joint.mat {options}" in out
    savemat("walk.mat", {"POSITION_SIGNAL": np.ones((9, 2)), "TORQUE_SIGNAL": np.ones((9, 2))})
    _, out, _ = tvsysid("inspect walk.mat")
    assert "--angle POSITION_SIGNAL --torque TORQUE_SIGNAL --rate HZ" in out
    assert tvsysid("inspect joint.mat --out deep/inside")[0] == 0
    for folder in ("tvsysid-inspect", "deep/inside"):
        assert (tmp_path / folder / "joint.mat.png").stat().st_size > 5000


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "only_identified")
def test_saved_settings_are_found_and_options_override_them(tvsysid, tmp_path):
    tvsysid("simulate joint.mat --duration 20")
    words = f"{IDENTIFY} --channel known=stiffness --torque-unit Nmm --save"
    code, out, _ = tvsysid(f"inspect joint.mat {words}")
    assert code == 0
    assert "wrote joint.mat.toml; identify with\ntvsysid identify joint.mat\n" in out
    code, out, err = tvsysid("identify joint.mat --method sds --torque-unit Nm --period 1")
    assert (code, err) == (0, "note: settings of joint.mat.toml; options override them\n")
    assert "18 realizations of 1 s at 100 Hz" in out
    assert "torque RMS 1.07 N·m" in out
    prepared = tv.prepare("joint.mat", torque_unit="Nm", period=1.0)
    assert repr(tv.compare(prepared, ["sds"])) in out
    for text, message in {
        "perod = 2": 'Unknown option: "[perod]" from joint.mat.toml. Did you mean --period?',
        "perod": "joint.mat.toml: Expected '=' after a key",
        'channels = ["emg"]': "--channel emg: expected NAME=CHANNEL",
    }.items():
        (tmp_path / "joint.mat.toml").write_text(text)
        code, _, err = tvsysid("identify joint.mat")
        assert (code, message in err) == (2, True)


@pytest.mark.slow
@pytest.mark.usefixtures("sketched")
def test_inspect_diagnoses(tvsysid, tmp_path):
    tvsysid("simulate joint.mat --duration 60")
    code, out, err = tvsysid(f"inspect joint.mat --diagnose {IDENTIFY}")
    assert (code, err) == (0, "")
    assert (
        "joint.mat (angle, torque): Diagnosis of 28 realizations of 2 s at 100 Hz: no fault found "
        "(29 of 32 checks are possible)" in out
    )
    assert (
        "not judged: mean-torque, mean-angle (the mean over realizations has been subtracted)"
        in out
    )
    assert "Recommendation: adaptive: the movement repeats, and adaptive finds" in out
    assert "wrote tvsysid-inspect/joint.mat.angle-torque.diagnosis.html" in out
    page = text_of(tmp_path / "tvsysid-inspect" / "joint.mat.angle-torque.diagnosis.html")
    assert "tvsysid inspect joint.mat --diagnose --angle angle" in page
    assert "Diagnosis of joint.mat (angle, torque)" in page
    options = f"{IDENTIFY} --torque-sign -1 --period 1.9"
    code, out, err = tvsysid(f"inspect joint.mat --diagnose {options}")
    assert (code, err) == (0, "")
    for words in (
        "- reversed-torque: the mean stiffness is -",
        "add --torque-sign -1",
        "- wrong-period: stiffness ",
        "varies by",
    ):
        assert words in out


@pytest.mark.parametrize(
    ("recorded", "options"),
    [
        (1000, "--rate 1000 --decimate 100"),
        (1024, "--rate 1024 --decimate 128"),
        (200, "--rate 200"),
        (None, "--rate HZ --decimate 100"),
    ],
)
def test_the_usual_rate_divides_that_of_the_recording(recorded, options):
    assert rate_options(recorded) == options
