"""Further channels and quantities, methods that are skipped, and names like markup."""

import numpy as np
import pandas as pd
import pytest

import tvsysid as tv

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("undrawn")]

METHODS = """
import tvsysid as tv


class Scheduled(tv.Method):
    inputs = (tv.Input("emg", "scheduling", "V"),)

    def fit(self, ensemble):
        emg = ensemble.signal("emg")[:, ensemble.core].mean(axis=0)
        estimates = {
            "stiffness": tv.Estimate([50.0, 100.0, 150.0], "N m/rad", axes=("emg",)),
            "emg_level": tv.Estimate(emg, "V"),
        }
        return tv.Model.of(ensemble, estimates=estimates, coordinates={"emg": [0.0, 0.5, 1.0]})


class Lazy(Scheduled):
    def skip(self, ensemble):
        return "it wants a [bold]holiday[/bold]"


class Faulty(tv.Method):
    def fit(self, ensemble):
        return 1 / 0
"""


@pytest.mark.usefixtures("only_identified")
def test_own_methods_of_which_one_is_skipped_and_one_fails(tvsysid, tmp_path, monkeypatch):
    # A joint of 100 N·m/rad at 100 Hz with EMG, in a file whose name looks like markup
    random = np.random.default_rng(0)
    angle, emg, noise = random.standard_normal((3, 4000)) * [[0.02], [0.1], [1.0]]
    emg += 1 + np.sin(np.pi * np.arange(4000) / 100)
    np.savez("[red]joint.npz", angle=angle, torque=100 * angle + noise, EMG_SIGNAL=emg)
    (tmp_path / "channel_methods.py").write_text(METHODS)
    monkeypatch.syspath_prepend(tmp_path)
    words = "identify [red]joint.npz --angle angle --torque torque --rate 100 --period 2 --method "
    own = " --method ".join(f"channel_methods:{name}" for name in ("Scheduled", "Lazy", "Faulty"))
    code, out, err = tvsysid(f"{words}{own} --method birf --channel emg=EMG_SIGNAL")
    assert code == 1
    assert err == ""
    for line in (
        "channel_methods:Lazy is skipped: it wants a [bold]holiday[/bold]",
        "channel_methods:Faulty failed: ZeroDivisionError: division by zero "
        "(channel_methods.py, line 24)",
    ):
        assert line in out.splitlines()
    # A quantity over time has a column of its own; one over EMG is in another table.
    table = pd.read_csv("tvsysid-identify/stiffness.csv").groupby("method").emg_level.mean()
    assert table["channel_methods:Scheduled"] == pytest.approx(1, abs=0.02)
    over_emg = pd.read_csv("tvsysid-identify/scheduled.csv").query("quantity == 'stiffness'")
    assert over_emg.estimate.agg(["mean", "min", "max"]).tolist() == [100, 50, 150]
    # If no method is left, that is an error.
    code, _, err = tvsysid(f"{words}channel_methods:Scheduled")
    assert code == 2
    assert "channel_methods:Scheduled: it needs the channel 'emg' (scheduling, V)" in err


def test_a_joint_that_follows_a_variable_needs_no_period(tvsysid):
    joint = tv.simulate.ScheduledJoint(
        relation=np.polynomial.Polynomial([28.9, 155.0, 310.0]),
        variable="ankle",
        variation=0.0,
        schedule=tv.simulate.SineWave(-0.1, 0.3, 10.0),
    )
    recording = joint.simulate(
        30, perturbation=tv.simulate.FilteredNoise(), snr_db=15, seed=1, rate=500
    ).recording
    ankle = recording.channels["ankle"]
    np.savez("moving.npz", angle=recording.angle, torque=recording.torque, ankle=ankle)
    words = "moving.npz --angle angle --torque torque --rate 500 --decimate 100 --scheduling ankle"
    code, out, err = tvsysid(f"identify {words} --out found")
    assert code == 0, err
    assert "1 realization" in out
    table = pd.read_csv("found/scheduled.csv")
    assert set(table.method) == {"lpv", "lpvkbi"}
    stiffness = table[(table.quantity == "scheduled_stiffness") & (table.method == "lpvkbi")]
    truth = joint.relation(stiffness.value.to_numpy())
    assert np.abs(stiffness.estimate - truth).max() < 3
    assert (stiffness.lower < stiffness.estimate).all()
