"""Running experiments: the same numbers whoever works, nothing lost, nothing done twice."""

from dataclasses import dataclass

import attrs
import numpy as np
import pytest
from tests.study.recorded.conftest import READING, SHORT, SMALL, write_trials

import tvsysid as tv
from tvsysid.preprocess import bootstrap_weights
from tvsysid.study import Experiment, run, summarize
from tvsysid.study.bootstraps import tasks_of


def test_results_lie_over_recording_analysis_bootstrap_and_time(small):
    results = small.results
    assert results.estimate.sel(quantity="stiffness").dims == (
        "recording",
        "analysis",
        "bootstrap",
        "time",
    )
    assert results.estimate.sel(quantity="stiffness").shape == (2, 6, 4, 256)
    assert results.analysis.values.tolist() == [
        "birf-10",
        "birf-20",
        "esm-10",
        "esm-20",
        "kbr-10",
        "kbr-20",
    ]
    assert np.isfinite(results.estimate.sel(quantity="stiffness")).all()
    assert (results.failure == "").all()
    assert results.unit.values.tolist()[:3] == ["N m/rad", "N m s/rad", "kg m2"]
    assert results.realizations.values.tolist() == [10, 20, 10, 20, 10, 20]


def test_a_draw_is_what_its_weights_say_and_all_methods_see_the_same(small):
    experiment, item = small.experiment, small.prepared[1]
    seed = experiment.seed_of(item.recorded, 20)
    for place, method in (
        (1, tv.BasisIRF(max_lag=15 / 128)),
        (3, tv.EnsembleSpectral(window=30 / 128)),
    ):
        weights = bootstrap_weights(len(item.ensemble), 20, 4, seed)
        drawn = item.ensemble.select(np.repeat(np.arange(len(item.ensemble)), weights[2]))
        model = method.identify(drawn)
        at = small.results.isel(recording=1, analysis=place, bootstrap=2)
        np.testing.assert_allclose(
            at.estimate.sel(quantity="stiffness"), model.stiffness, rtol=1e-9
        )
        torque, predicted = drawn.torque[:, drawn.core], model.predict(drawn)
        assert float(at.vaf) == pytest.approx(tv.metrics.vaf(torque, predicted).mean())
        assert float(at.bandpassed_vaf) == pytest.approx(
            tv.metrics.bandpassed_vaf(torque, predicted, 128.0).mean()
        )
        np.testing.assert_allclose(
            at.time_varying_vaf, tv.metrics.time_varying_vaf(torque, predicted)
        )


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
    experiment = Experiment(
        participants={"P1": {"noise": "trial*.mat"}}, folder=tmp_path, reading=READING,
        preparation=SHORT,
        methods=[Counting(str(log))], realizations=5, bootstraps=200,
    )  # fmt: skip
    results = run(experiment, workers=1)
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


@dataclass(frozen=True)
class Sometimes(tv.Method):
    """Fails where the first realization drawn begins early in its trial."""

    contiguous = True

    def fit(self, ensemble):
        if ensemble.onsets[0] < 6:
            raise RuntimeError("too early")
        return tv.BasisIRF().identify(ensemble)


@pytest.mark.slow
def test_draws_that_fail_are_told_and_the_others_count(tmp_path, small):
    experiment = Experiment(
        **SMALL | {"methods": [Sometimes(), "birf"], "bootstraps": 30, "perturbation": "noise"}
    )
    results = run(experiment, prepared=small.prepared[:1], workers=1)
    failed = np.isnan(results.vaf.sel(analysis="Sometimes()-10").values[0])
    assert 0 < failed.sum() < 30
    texts = results.failure.sel(analysis="Sometimes()-10").values[0]
    np.testing.assert_array_equal(texts != "", failed)
    assert texts[failed][0].startswith("RuntimeError: too early")
    table = summarize(results).set_index(["method", "realizations", "metric"]).value
    assert table["Sometimes()", 10, "failed"] == failed.sum()
    assert np.isfinite(table["Sometimes()", 10, "vaf"])
    assert table["birf", 10, "failed"] == 0


def test_more_realizations_in_one_piece_than_there_are_is_told(tmp_path):
    write_trials(tmp_path)
    experiment = Experiment(
        participants={"P1": {"noise": "trial*.mat"}}, folder=tmp_path, reading=READING,
        preparation=SHORT,
        methods=["kbr", "birf"], realizations=50, bootstraps=2,
    )  # fmt: skip
    results = run(experiment, workers=1)
    failures = results.failure.values[0, 0]
    assert all("a block of 50 realizations cannot be drawn from" in text for text in failures)
    assert "50 realizations are drawn from 33: they vary less" in str(results.remarks.values[0])
    assert np.isfinite(results.estimate.sel(quantity="stiffness").values[0, 1]).all()


def test_doubts_of_every_draw_are_kept(small):
    experiment = Experiment(
        **SMALL | {"methods": "eirf", "perturbation": "noise", "realizations": 20}
    )
    results = run(experiment, prepared=small.prepared[:1], workers=1)
    for text in results.warnings.values[0, 0]:
        assert text.count("20 realizations are fewer than the 31 lags") == 1
