"""Figure of what was identified from one recording."""

import attrs
import numpy as np
import pytest
from matplotlib.figure import Figure
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.figures import held_out_prediction, identified_impedance
from tvsysid.figures.style import lines
from tvsysid.models import StandardError


@pytest.fixture(scope="module")
def drawn():
    ensemble = ensemble_of(150.0, "sine", "prbs")
    models = {key: tv.methods.parse(key).identify(ensemble) for key in ("sds", "kbr")}
    bands = {
        label: {
            name: model.estimates[name].band() for name in ("stiffness", "viscosity", "inertia")
        }
        for label, model in models.items()
    }
    vaf = {label: np.full(ensemble.samples, 90.0) for label in models}
    figure = identified_impedance(models, vaf, "a recording")
    return models, bands, {axes.get_ylabel().split(" (")[0]: axes for axes in figure.axes}


def test_each_quantity_has_its_axes_with_unit(drawn):
    _, _, axes = drawn
    assert set(axes) == {"stiffness", "viscosity", "inertia", "time-varying VAF"}
    assert "N·m·s/rad" in axes["viscosity"].get_ylabel()
    assert axes["inertia"].get_xlabel() == "time within a realization (s)"


def test_the_first_method_stands_out(drawn):
    for axes in drawn[2].values():
        first, second = axes.lines
        assert first.get_linewidth() > 1.5 * second.get_linewidth()
        assert first.get_zorder() > second.get_zorder()


@pytest.mark.parametrize("name", ["stiffness", "viscosity", "inertia"])
def test_lines_are_the_estimates_and_shades_the_bands(drawn, name):
    models, bands, axes = drawn
    drawings = axes[name].lines, axes[name].collections
    for line, shade, (label, model) in zip(*drawings, models.items(), strict=True):
        np.testing.assert_array_equal(line.get_ydata(), getattr(model, name))
        assert line.get_color() == lines(list(models))[label]["color"]
        lower, upper = bands[label][name]
        corners = shade.get_paths()[0].vertices[:, 1]
        assert corners.min() == pytest.approx(lower.min())
        assert corners.max() == pytest.approx(upper.max())


def test_what_no_method_identified_is_said():
    time = np.arange(200) / 100
    model = tv.Model.of(ensemble_of(40.0), 100.0)
    figure = identified_impedance({"mine": model}, {"mine": np.full_like(time, 90.0)})
    told = {
        axes.get_ylabel().split(" (")[0]: [text.get_text() for text in axes.texts]
        for axes in figure.axes
    }
    assert told["viscosity"] == told["inertia"] == ["not identified"]
    assert told["stiffness"] == []


def test_any_quantity_is_drawn_over_its_own_axis():
    time, levels = np.arange(200) / 100, np.linspace(0.0, 1.0, 11)

    class Further(tv.models.Model):
        def _pathways(self, ensemble):
            return {}

    estimates = {
        "stiffness": tv.Estimate(100 + time, "N m/rad"),
        "reflex_gain": tv.Estimate(
            np.stack([time, 3 * time]), "N m s/rad", ("realization", "time")
        ),
        "slope": tv.Estimate(
            2 * levels, "kg m2", ("emg",), StandardError(0.1 + 0 * levels, np.inf)
        ),
    }
    model = Further(
        method="own",
        sampling_rate=100.0,
        time=time,
        estimates=estimates,
        diagnostics=tv.models.Diagnostics(1.0),
        coordinates={"emg": levels},
    )
    figure = identified_impedance({"own": model}, {"own": np.full(200, 90.0)})
    axes = {each.get_ylabel(): each for each in figure.axes}
    gain, slope = axes["reflex gain (N·m·s/rad)"], axes["slope (kg·m²)"]
    np.testing.assert_allclose(gain.lines[0].get_ydata(), 2 * time)
    np.testing.assert_array_equal(slope.lines[0].get_xdata(), levels)
    assert slope.get_xlabel() == "emg"
    assert slope.collections[0].get_paths()[0].vertices[:, 1].max() == pytest.approx(
        2.0 + 1.96 * 0.1, abs=1e-3
    )


def test_the_whole_band_of_the_first_method_is_shown(drawn):
    first = drawn[0]["sds"]
    wide = tv.Estimate(
        np.full(200, 40.0), "N m s/rad", error=StandardError(np.full(200, 10.0), np.inf)
    )
    model = attrs.evolve(first, estimates={**first.estimates, "reflex_gain": wide})
    for models in ({"one": model}, {"one": model, "other": model}):
        axes = {each.get_ylabel(): each for each in identified_impedance(models, {}).axes}
        low, high = axes["reflex gain (N·m·s/rad)"].get_ylim()
        assert low < 20
        assert high > 60


def test_a_rough_curve_does_not_hide_the_others(drawn):
    models, bands, _ = drawn
    noise = tv.Estimate(400 * np.random.default_rng(0).normal(size=200), "N m/rad")
    wild = attrs.evolve(models["kbr"], estimates={"stiffness": noise})
    axes = identified_impedance(models | {"eirf": wild}, {}).axes[0]
    low, high = axes.get_ylim()
    assert high - low < 4 * np.ptp(models["sds"].stiffness)
    assert low < bands["sds"]["stiffness"][0].min()


def test_likely_switches_are_marked():
    model = tv.AdaptiveRegression().identify(ensemble_of(60.0, "square"))
    labels = [line.get_label() for line in model.plot().axes[0].lines[1:]]
    assert labels == [
        f"stiffness {switch.size:+.3g} at {switch.time:.3f} s".replace("-", "−")
        for switch in model.switches
    ]
    assert len(labels) == 2


def test_a_model_draws_its_stiffness_into_axes_that_are_given(drawn):
    model, axes = drawn[0]["kbr"], Figure().add_subplot()
    assert model.plot("before training", ax=axes) is axes.figure
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), model.stiffness)
    assert axes.get_title() == "before training"


def test_held_out_torque_its_residual_and_the_autocorrelation_within_realizations():
    random = np.random.default_rng(3)
    measured = random.normal(size=(40, 200))
    white = 0.5 * random.normal(size=measured.shape)
    figure = held_out_prediction(np.stack([measured, measured - white]), 100.0)
    torque, residual, correlation = figure.axes
    np.testing.assert_array_equal(torque.lines[0].get_ydata(), measured[:3].ravel())
    np.testing.assert_allclose(residual.lines[0].get_ydata(), white[:3].ravel())
    tops = np.array([each[1] for each in correlation.collections[-1].get_segments()])
    np.testing.assert_allclose(tops[:, 0], np.arange(1, 50) / 100)
    assert tops[4, 1] == pytest.approx(np.sum(white[:, 5:] * white[:, :-5]) / np.sum(white**2))
    assert np.mean(np.abs(tops[:, 1]) < 1.96 / np.sqrt(white.size)) > 0.85
