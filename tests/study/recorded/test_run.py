"""Running experiments: the draws, what fails, and what their metrics are."""

from dataclasses import dataclass

import attrs
import numpy as np
import pytest
from tests.study.recorded.conftest import READING, SHORT, SMALL, write_trials

import tvsysid as tv
from tvsysid.preprocess import bootstrap_weights
from tvsysid.study import Experiment, run, stiffness_over_time, summarize
from tvsysid.study.bootstraps import tasks_of


def of_files(folder, **settings):
    return Experiment(
        participants={"P1": {"noise": "trial*.mat"}}, folder=folder, reading=READING,
        preparation=SHORT, **settings,
    )  # fmt: skip


def of_noise(small, **settings):
    """Run an experiment on the first of the small one's recordings."""
    experiment = Experiment(**SMALL | {"perturbation": "noise"} | settings)
    return run(experiment, prepared=small.prepared[:1], workers=1)


def test_results_lie_over_recording_analysis_bootstrap_and_time(small):
    results = small.results
    stiffness = results.estimate.sel(quantity="stiffness")
    assert stiffness.dims == ("recording", "analysis", "bootstrap", "time")
    assert stiffness.shape == (2, 6, 4, 256)
    keys = ("birf", "esm", "kbr")
    assert results.analysis.values.tolist() == [f"{key}-{n}" for key in keys for n in (10, 20)]
    assert np.isfinite(stiffness).all()
    assert (results.failure == "").all()
    assert results.unit.values.tolist() == ["N m/rad", "N m s/rad", "kg m2"]
    assert results.realizations.values.tolist() == [10, 20] * 3


@pytest.mark.parametrize(
    ("place", "method"),
    [(1, tv.BasisIRF(max_lag=15 / 128)), (3, tv.EnsembleSpectral(window=30 / 128))],
)
def test_a_draw_is_what_its_weights_say_and_all_methods_see_the_same(small, place, method):
    item = small.prepared[1]
    count, seed = len(item.ensemble), small.experiment.seed_of(item.recorded, 20)
    weights = bootstrap_weights(count, 20, 4, seed)
    drawn = item.ensemble.select(np.repeat(np.arange(count), weights[2]))
    model = method.identify(drawn)
    at = small.results.isel(recording=1, analysis=place, bootstrap=2)
    stiffness = at.estimate.sel(quantity="stiffness")
    np.testing.assert_allclose(stiffness, model.stiffness, rtol=1e-9)
    pair = drawn.torque[:, drawn.core], model.predict(drawn)
    assert float(at.vaf) == pytest.approx(tv.metrics.vaf(*pair).mean())
    bandpassed = tv.metrics.bandpassed_vaf(*pair, 128.0).mean()
    assert float(at.bandpassed_vaf) == pytest.approx(bandpassed)
    np.testing.assert_allclose(at.time_varying_vaf, tv.metrics.time_varying_vaf(*pair))


@dataclass(frozen=True)
class Counting(tv.Method):
    """Counts how often it is asked, in a file."""

    file: str
    contiguous = True

    def fit(self, ensemble):
        with open(self.file, "a") as log:
            log.write("x")
        return tv.BasisIRF().identify(ensemble)


@pytest.mark.slow
def test_the_same_draw_is_identified_once(tmp_path):
    write_trials(tmp_path)
    log = tmp_path / "asked.txt"
    settings = {"methods": [Counting(str(log))], "realizations": 5, "bootstraps": 200}
    results = run(of_files(tmp_path, **settings), workers=1)
    # No more blocks than realizations to begin at.
    assert len(log.read_text()) <= int(results.survivors[0]) < 40
    assert np.isfinite(results.estimate.sel(quantity="stiffness")).all()


def test_the_data_and_the_draws_are_in_the_name_of_a_task(small):
    def names(prepared, **settings):
        experiment = Experiment(**{"virtual": 1, "methods": "sds", "bootstraps": 4} | settings)
        return {task.file_name for task in tasks_of(experiment, prepared)}

    usual = names(small.prepared)
    assert len(usual) == 4
    pairs = zip(small.prepared, small.prepared[::-1], strict=True)
    swapped = [attrs.evolve(one, ensemble=other.ensemble) for one, other in pairs]
    assert not usual & names(swapped)
    for change in ({"bootstraps": 5}, {"seed": 1}, {"methods": "sds:window=0.2"}):
        assert not usual & names(small.prepared, **change)


class Sometimes(tv.Method):
    """Fails where the first realization drawn begins early in its trial."""

    contiguous = True

    def fit(self, ensemble):
        if ensemble.onsets[0] < 6:
            raise RuntimeError("too early")
        return tv.BasisIRF().identify(ensemble)


@pytest.mark.slow
def test_draws_that_fail_are_told_and_the_others_count(small):
    results = of_noise(small, methods=[Sometimes(), "birf"], bootstraps=30)
    at = results.sel(analysis="Sometimes-10", recording="P1-noise")
    failed = np.isnan(at.vaf.values)
    assert 0 < failed.sum() < 30
    np.testing.assert_array_equal(at.failure != "", failed)
    assert at.failure.values[failed][0].startswith("RuntimeError: too early")
    table = summarize(results).set_index(["method", "realizations", "metric"]).value
    assert table["Sometimes", 10, "failed"] == failed.sum()
    assert np.isfinite(table["Sometimes", 10, "vaf"])
    assert table["birf", 10, "failed"] == 0


@pytest.mark.parametrize(("realizations", "drawn"), [([20, 50], 20), ([50, 60], 33)])
def test_no_draw_has_more_realizations_than_there_are(tmp_path, realizations, drawn):
    write_trials(tmp_path)
    settings = {"methods": ["kbr", "birf"], "realizations": realizations, "bootstraps": 2}
    results = run(of_files(tmp_path, **settings), workers=1)
    assert results.analysis.values.tolist() == [f"kbr-{drawn}", f"birf-{drawn}"]
    assert np.isfinite(results.estimate.sel(quantity="stiffness")).all()


def test_warnings_of_every_draw_are_kept(small):
    results = of_noise(small, methods="eirf", realizations=20)
    for text in results.warnings.values[0, 0]:
        assert text.count("20 realizations are fewer than the 31 lags") == 1


class Sloped(tv.Method):
    quantities = {"emg_slope": "N m/V", "ratio": ""}  # noqa: RUF012

    def fit(self, ensemble):
        estimates = dict(tv.ShortDataSegments().fit(ensemble).estimates)
        for value, (name, unit) in enumerate(self.quantities.items()):
            estimates[name] = tv.Estimate(np.full(ensemble.samples, value), unit)
        return tv.Model.of(ensemble, estimates=estimates)


def test_a_quantity_of_one_s_own_is_summarized_with_its_unit(small):
    results = of_noise(small, methods=[Sloped()], bootstraps=2)
    assert str(results.unit.sel(quantity="emg_slope").values) == "N m/V"
    table = summarize(results).set_index(["realizations", "metric"]).loc[20]
    assert tuple(table.loc["emg_slope mean", ["value", "unit"]]) == (0, "N·m/V")
    assert tuple(table.loc["ratio mean", ["value", "unit"]]) == (1, "")


def test_every_metric_is_as_defined(small):
    results = small.results
    labels = ["participant", "perturbation", "method", "realizations"]
    table = summarize(results).set_index(labels).loc["P1", "prbs", "esm", 20]
    table = table.set_index("metric").value
    at = results.sel(recording="P1-prbs", analysis="esm-20")
    estimate, truth = (at[name].sel(quantity="stiffness") for name in ("estimate", "truth"))
    expected = {
        "mean_stiffness": estimate.mean(),
        "random_error": np.sqrt(estimate.var("bootstrap", ddof=1).mean()),
        "vaf": at.vaf.mean(),
        "bandpassed_vaf": at.bandpassed_vaf.mean(),
        "lowest_time_varying_vaf": at.time_varying_vaf.mean("bootstrap").min(),
        "bias_error": tv.metrics.bias_error(estimate.values, truth.values),
        "mean_bias": (estimate.mean("bootstrap") - truth).mean(),
    }
    for name, value in expected.items():
        assert table[name] == pytest.approx(float(value)), name
    people = results.assign(truth=results.truth * np.nan)
    assert not {"bias_error", "mean_bias"} & set(summarize(people).metric)


def test_stiffness_over_time_has_mean_and_spread(small):
    table = stiffness_over_time(small.results)
    assert list(table.columns) == [
        *("participant", "perturbation", "method", "realizations", "time_s"),
        *("stiffness", "standard_deviation", "time_varying_vaf"),
    ]
    assert len(table) == 2 * 6 * 256
    rows = table.set_index(["perturbation", "method", "realizations"]).loc["noise", "birf", 10]
    at = small.results.sel(recording="P1-noise", analysis="birf-10", quantity="stiffness").estimate
    np.testing.assert_allclose(rows.stiffness, at.mean("bootstrap"))
    np.testing.assert_allclose(rows.standard_deviation, at.std("bootstrap", ddof=1))
    np.testing.assert_allclose(rows.time_s, small.results.time)
