"""Everything that has a picture shows it, and a line in a notebook."""

import numpy as np
import pytest
from matplotlib import pyplot
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.errors import InputError


@pytest.fixture(scope="module")
def ensemble():
    return ensemble_of(40.0, "sine", "prbs")


@pytest.fixture(scope="module")
def comparison(ensemble):
    return tv.compare(ensemble, ["sds", "esm"])


def labels(figure):
    return [axes.get_ylabel().partition("\n")[0].partition(" (")[0] for axes in figure.axes]


def test_recording_and_ensemble(ensemble):
    recording = tv.Recording(ensemble.angle.ravel(), ensemble.torque.ravel(), 100.0)
    figure = recording.plot("a joint")
    assert labels(figure) == ["angle", "torque"]
    assert figure.get_suptitle() == "a joint"
    assert "10 s of 60 s" in figure.axes[0].get_title("left")
    first = ensemble.plot().axes[0]
    shown = ensemble.angle[:, ensemble.core]
    np.testing.assert_array_equal(np.array(first.collections[0].get_segments())[..., 1], shown)
    np.testing.assert_array_equal(first.lines[0].get_ydata(), shown.mean(axis=0))


def test_comparison_and_model(comparison):
    impedance = ["stiffness", "viscosity", "inertia"]
    figure = comparison.plot()
    assert labels(figure) == ["stiffness", *impedance[1:], "time-varying VAF"]
    figure = comparison.models["sds"].plot()
    assert labels(figure) == impedance  # without an ensemble there is no VAF
    assert figure.legends[0].texts[0].get_text().startswith("ShortDataSegments(")


def test_what_has_no_picture():
    with pytest.raises(InputError, match="there is no picture of int"):
        tv.figures.plot(1)


def test_pyplot_knows_a_figure_until_a_notebook_or_a_file_has_it(ensemble, tmp_path):
    figure = ensemble.plot()
    assert pyplot.gcf() is figure
    (content,), (size,) = (each.values() for each in figure._repr_mimebundle_())
    assert content.startswith(b"\x89PNG")
    assert size == {"width": 756, "height": round(108 * figure.get_figheight())}
    assert not pyplot.get_fignums()
    tv.figures.save(ensemble.plot(), tmp_path / "figure.png")
    assert not pyplot.get_fignums()


def test_a_simulation_draws_its_recording():
    joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
    simulation = joint.simulate(2, perturbation=tv.simulate.PRBS(), snr_db=10, seed=1)
    assert labels(simulation.plot()) == ["angle", "torque"]
