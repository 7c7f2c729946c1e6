import numpy as np
import pytest
from tests.study.conftest import SMALL
from tests.synthetic import results_of

import tvsysid as tv
from tvsysid.study import Study, run, score, summarize
from tvsysid.study.scores import COLUMNS, METRICS

SQUARE = tv.simulate.SquareWave()(np.arange(200) / 100)


def made_up(estimates, over_time=90.0, covered=1.0):
    """Make results of one scenario and one method from arrays of shape (trial, time)."""
    results = results_of([("square", "prbs", 150.0, 10.0)], ("sds",), len(estimates))
    for name, values in (("estimate", estimates), ("covered", covered)):
        results[name][0, :, 0, 0] = values
    results.time_varying_vaf[0, :, 0] = over_time
    return results


def noisy(random, trials, spread=3.0, bias=2.0):
    return SQUARE + bias + spread * random.normal(size=(trials, 200))


@pytest.mark.slow
def test_summary_holds_every_metric(results):
    table = summarize(score(results))
    of_experiment = {"participant", "realizations", "bootstraps"}
    assert list(table.columns) == [name for name in COLUMNS if name not in of_experiment]
    of_stiffness = {name for name in table.metric if " " not in name}
    assert of_stiffness == set(METRICS) - {"mean"} | {"mean_stiffness"}
    others = {name.partition(" ")[0] for name in {*table.metric} - of_stiffness}
    assert others == {"viscosity", "inertia"}
    rows = table[(table.method == "sds") & (table.perturbation == "prbs")]
    cell = rows.set_index("metric").value
    found = results.sel(scenario="square-prbs-60s-10dB", method_key="sds")
    own = found.sel(quantity="stiffness")
    bias = tv.metrics.bias_error(own.estimate.values, own.truth.values)
    assert cell["bias_error"] == pytest.approx(bias, rel=1e-12)  # sums in another order
    assert cell["rise_time"] == tv.metrics.rise_time(results.time.values, own.estimate.values)
    assert cell["coverage"] == pytest.approx(100 * own.covered.values.mean())
    assert cell["lowest_vaf"] == found.vaf.min()
    assert cell["failed"] == 0
    assert set(table.trials) == {3}
    sine = summarize(score(run(Study(**SMALL | {"stiffness": ["sine"]}), workers=1)))
    assert set(METRICS) - set(sine.metric) == {"mean", "rise_time", "switch_dip"}


def test_replicates_of_equal_weights_are_the_metrics_themselves(monkeypatch, random):
    results = made_up(noisy(random, 8), 90 + random.normal(size=(8, 200)))

    class Even:
        def multinomial(self, count, shares, size):
            return np.ones((size, count), dtype=int)

    monkeypatch.setattr(np.random, "default_rng", lambda seed: Even())
    scores = score(results)
    for name in set(METRICS) - {"lowest_vaf", "failed", "debiased_bias_error"}:
        at = scores.sel(metric=name)
        # What is drawn varies less than what it is drawn from, which replicates of spreads make up
        # for.
        factor = np.sqrt(8 / 7) if name == "random_error" or "_sd" in name else 1
        np.testing.assert_allclose(at.replicates, factor * at.value.item(), rtol=1e-9, err_msg=name)


@pytest.mark.slow
def test_standard_errors_are_the_spread_of_repeated_studies(random):
    names = ["bias_error", "debiased_bias_error", "random_error", "total_error", "coverage"]
    repeated = []
    for _ in range(100):
        estimates = noisy(random, 40)
        scores = score(made_up(estimates, covered=np.abs(estimates - SQUARE) <= 5))
        repeated.append(scores.sel(metric=names).squeeze())
    told = np.mean([one.standard_error for one in repeated], axis=0)
    np.testing.assert_allclose(told, np.std([one.value for one in repeated], axis=0), rtol=0.3)


def test_replicates_of_the_debiased_bias_are_centred_on_it(random):
    scores = score(made_up(noisy(random, 30, spread=10.0, bias=3.0)))
    at, plain = (scores.sel(metric=name) for name in ("debiased_bias_error", "bias_error"))
    assert float(at.replicates.mean()) == pytest.approx(
        at.value.item(), abs=0.25 * at.standard_error.item() + 0.05
    )
    assert float(plain.replicates.mean()) > plain.value.item() + 0.1


def test_one_trial_has_no_spread_and_no_standard_error(random):
    scores = score(made_up(noisy(random, 1)))
    assert np.isnan(scores.standard_error).all()
    assert np.isfinite(scores.value.sel(metric=["bias_error"])).all()
    assert np.isnan(scores.value.sel(metric=["random_error", "debiased_bias_error"])).all()


def test_draws_of_methods_are_paired_also_where_trials_failed(random):
    results = results_of([("square", "prbs", 150.0, 10.0)], ("sds", "esm"), 10)
    results["failure"][0, 2:, 1] = "x"
    scores = score(results).sel(method_key="esm")
    drawn = np.random.default_rng(0).multinomial(
        10, np.full(10, 0.1), size=scores.sizes["replicate"]
    )
    known = np.isfinite(scores.replicates.sel(metric="total_error").values[0])
    np.testing.assert_array_equal(known, drawn[:, :2].any(axis=1))


def test_a_dip_at_the_switches_is_measured(random):
    over_time = np.full((4, 200), 95.0)
    over_time[:, 45:56] = over_time[:, 145:156] = 75.0
    at = score(made_up(noisy(random, 4), over_time)).sel(metric="switch_dip")
    assert at.value.item() == 20
    assert at.standard_error.item() < 1e-9


def test_spreads_where_the_joint_is_soft_and_stiff(random):
    over_time = 90 + np.where(SQUARE < 100, 2.0, 1.0) * np.array([[-1.0], [1.0]])
    values = score(made_up(noisy(random, 2), over_time)).value
    names = [f"time_varying_vaf_sd{ending}" for ending in ("_soft", "_stiff", "")]
    assert values.sel(metric=names).values.ravel().tolist() == [2, 1, 1.5]


def test_failed_trials_are_left_out_and_counted(random):
    estimates = noisy(random, 5)
    results = made_up(estimates)
    results.estimate[0, 2] = np.nan
    results.failure[0, 2] = "x"
    scores = score(results)
    assert scores.trials.item() == 4
    assert scores.value.sel(metric="failed").item() == 1
    kept = np.delete(estimates, 2, axis=0)
    assert scores.value.sel(metric="random_error").item() == tv.metrics.random_error(kept)
    assert np.isfinite(scores.replicates.sel(metric="total_error")).all()
    results.failure[:] = "x"
    assert np.isnan(score(results).value.sel(metric="bias_error")).all()


def test_coverage_counts_every_band_there_is(random):
    def coverage_of(covered):
        return score(made_up(noisy(random, 4), covered=covered)).sel(metric="coverage")

    covered = np.ones((4, 200))
    covered[1, :100] = np.nan
    covered[2, 100:150] = 0.0
    assert coverage_of(covered).value.item() == pytest.approx(100 * (1 - 50 / 700))
    covered[1] = np.nan
    at = coverage_of(covered)
    assert at.value.item() == pytest.approx(100 * (1 - 50 / 600))
    # A draw of the trial without a band alone, one of 256, tells nothing.
    assert np.isnan(at.replicates).mean() == pytest.approx(1 / 256, abs=0.01)
    assert np.isnan(coverage_of(np.full((4, 200), np.nan)).value).all()


def test_a_truth_that_changes_from_trial_to_trial_is_scored_by_trial():
    settings = {"system": "scheduled", "stiffness": "sine", "duration_s": 20, "trials": 3}
    found = run(Study(**settings, perturbation="prbs", methods="birf"), workers=1)
    truth = found.trial_truth.sel(quantity="stiffness").values[0]
    assert np.ptp(truth, axis=0).max() > 0.1
    off = found.estimate.sel(quantity="stiffness").values[0, :, 0] - truth
    total = score(found).value.sel(metric="total_error").item()
    assert total == pytest.approx(np.sqrt(np.mean(off**2)))
