"""Test that methods with own pathways, inputs and estimates go wherever the package's go."""

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from tests.conftest import realizations
from tests.contracts import toys
from tests.contracts.toys import Cascade, Instrumental, Recursive, Scheduled

import tvsysid as tv

SYSTEMS = {
    Cascade: tv.simulate.ReflexJoint(
        stiffness=tv.simulate.SineWave(), reflex_gain=tv.simulate.SineWave(8.0, 4.0)
    ),
    Scheduled: tv.simulate.ScheduledJoint(stiffness=tv.simulate.SineWave()),
    Instrumental: tv.simulate.CompliantActuator(
        stiffness=tv.simulate.SineWave(), noise_bandwidth=2.0
    ),
    Recursive: tv.simulate.Joint(stiffness=tv.simulate.SineWave()),
}
"""What suits each."""
ERROR = {"stiffness": 8.0, "viscosity": 0.3, "inertia": 0.004, "reflex_gain": 1.5}
"""Root-mean-square error allowed on 150 s at 10 dB."""

every_toy = pytest.mark.parametrize("toy", list(SYSTEMS), ids=lambda toy: toy.__name__)


@cache
def simulated(toy):
    simulation = SYSTEMS[toy].simulate(
        150, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1
    )
    ensemble = realizations(simulation.recording)
    return simulation, tv.preprocess.subtract_mean(ensemble, tv.methods.centered_channels([toy()]))


@every_toy
def test_finds_what_the_simulation_knows(toy):
    simulation, ensemble = simulated(toy)
    model = toy().identify(ensemble)
    truth = simulation.truth_of(ensemble)
    assert truth.keys() <= model.estimates.keys()
    for name, values in truth.items():
        found = np.broadcast_to(model.estimates[name].values, values.shape)
        assert np.sqrt(np.nanmean((found - values) ** 2)) < ERROR[name], name
    torques = model.pathways(ensemble)
    assert torques.keys() == simulation.pathways.keys()
    np.testing.assert_allclose(model.predict(ensemble), sum(torques.values()))


def test_an_instrument_removes_the_bias_of_a_closed_loop():
    simulation, ensemble = simulated(Instrumental)
    truth = simulation.truth_of(ensemble)["stiffness"].mean()
    biased = tv.BasisIRF().identify(ensemble).stiffness.mean() - truth
    unbiased = np.nanmean(Instrumental().identify(ensemble).estimates["stiffness"].values) - truth
    assert abs(unbiased) < abs(biased) / 4


@every_toy
def test_takes_part_in_a_comparison(toy):
    _, ensemble = simulated(toy)
    found = tv.compare(ensemble, [toy(), "sds"])
    assert list(found.models) == [toy.__name__, "sds"]
    assert found.vaf[toy.__name__].mean() > 80
    lower, _ = found.models[toy.__name__].band("stiffness")
    # The mean of realizations has no band
    assert np.isnan(lower).all() == (toy in (Recursive, Scheduled))
    assert np.isfinite(found.summary()["stiffness (N·m/rad)"]).all()


@pytest.mark.parametrize("toy", [Scheduled, Instrumental])
def test_is_skipped_where_its_channel_is_missing(toy):
    _, ensemble = simulated(Recursive)
    (item,) = toy.inputs
    found = tv.compare(ensemble, [toy(), "sds"])
    assert list(found.models) == ["sds"]
    assert (
        f"it needs the channel {item.name!r} ({item.kind}, {item.unit})"
        in found.skipped[toy.__name__]
    )
    with pytest.raises(tv.InputError, match=f"it needs the channel {item.name!r}"):
        toy().identify(ensemble)


@every_toy
def test_comes_back_from_the_file_of_models(toy, tmp_path):
    _, ensemble = simulated(toy)
    model = toy().identify(ensemble)
    tv.recordings.write_models(tmp_path / "models.nc", {"toy": model}, ensemble)
    with xr.open_datatree(tmp_path / "models.nc") as tree:
        stored = tree["toy"].to_dataset().load()
    expected = {f"torque_{name}": each for name, each in model.pathways(ensemble).items()}
    for name, estimate in model.estimates.items():
        assert stored[name].dims == estimate.axes
        assert stored[name].attrs["units"] == estimate.unit
        expected[name] = estimate.values
        if (error := estimate.standard_error) is not None:
            expected[f"{name}_standard_error"] = error.values
            expected[f"{name}_lower"], expected[f"{name}_upper"] = estimate.band()
    for name, values in (expected | model.coordinates).items():
        np.testing.assert_array_equal(stored[name].values, values)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("system", "together"),
    [("scheduled", (Scheduled, Cascade)), ("compliant", (Instrumental, Recursive))],
)
def test_take_part_in_identify(system, together, tmp_path, tvsysid):
    (tmp_path / "mytoys.py").write_bytes(Path(toys.__file__).read_bytes())
    inputs = [item for toy in together for item in toy().inputs]
    signals = ["--angle=angle", "--torque=torque", "--rate=1000", "--decimate=100", "--period=2"]
    signals += [f"--channel={item.name}={item.name}" for item in inputs]
    labels = {toy: f"mytoys:{toy.__name__}" for toy in together}
    methods = [f"--method={label}" for label in labels.values()]
    for words in (
        ["simulate", "ankle.mat", f"--system={system}", "--duration=40"],
        ["identify", "ankle.mat", *signals, *methods],
    ):
        code, _, err = tvsysid(*words)
        assert code == 0, err
    with xr.open_datatree(tmp_path / "tvsysid-identify" / "models.nc") as tree:
        for toy, label in labels.items():
            stored = tree[label].to_dataset()
            assert ("torque_reflex" in stored) == ("reflex_gain" in stored) == (toy is Cascade)
            assert ("stiffness_lower" in stored) == (toy is not Recursive)
    table = pd.read_csv(tmp_path / "tvsysid-identify" / "stiffness.csv")
    assert set(table.method) == set(labels.values())


@every_toy
def test_is_bootstrapped_with_its_channels(toy):
    _, ensemble = simulated(toy)
    found = tv.uncertainty.bootstrap(toy(), ensemble, 5, seed=1)
    lower, upper = found.band("stiffness")
    assert (lower <= upper)[np.isfinite(lower)].all()
    assert np.isfinite(lower).mean() > 0.9
