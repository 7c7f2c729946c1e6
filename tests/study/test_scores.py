import numpy as np
import pytest
import xarray as xr
from tests.study.conftest import SMALL

import tvsysid as tv
from tvsysid.study import Study, run, score, summarize
from tvsysid.study.scores import METRICS
from tvsysid.study.summary import COLUMNS


def made_up(estimates, over_time=None, profile="square", covered=None):
    """Make results of one scenario and one method from stiffness of shape (trial, time).

    Its bands are ± 5 N·m/rad.
    """
    trials = len(estimates)
    time = np.arange(200) / 100
    truth = np.asarray(tv.simulate.PROFILES[profile](time))
    cell = ("scenario", "trial", "method_key")
    covered = (
        np.where(np.isfinite(estimates), np.abs(estimates - truth) <= 5, np.nan)
        if covered is None
        else covered
    )
    over_time = np.full((trials, 200), 90.0) if over_time is None else over_time
    return xr.Dataset(
        {
            "estimate": ((*cell, "quantity", "time"), estimates[None, :, None, None]),
            "time_varying_vaf": ((*cell, "time"), over_time[None, :, None]),
            "covered": ((*cell, "quantity", "time"), covered[None, :, None, None]),
            "vaf": (cell, np.linspace(90, 99, trials)[None, :, None]),
            "bandpassed_vaf": (cell, np.linspace(80, 89, trials)[None, :, None]),
            "seconds": (cell, np.ones((1, trials, 1))),
            "failure": (cell, np.full((1, trials, 1), "")),
            "truth": (("scenario", "quantity", "time"), truth[None, None]),
        },
        coords={
            "scenario": ["cell"], "method_key": ["mine"], "quantity": ["stiffness"],
            "unit": ("quantity", ["N m/rad"]),
            "trial": np.arange(trials),
            "time": time,
            "profile": ("scenario", [profile]), "perturbation": ("scenario", ["prbs"]),
            "duration_s": ("scenario", [150.0]), "snr_db": ("scenario", [10.0]),
            "viscosity": ("scenario", ["constant"]), "system": ("scenario", ["joint"]),
            "asked": (("scenario", "method_key"), [[True]]),
        },
    )  # fmt: skip


def noisy(random, trials, spread=3.0, bias=2.0):
    truth = tv.simulate.SquareWave()(np.arange(200) / 100)
    return truth + bias + spread * random.normal(size=(trials, 200))


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
    assert cell["bias_error"] == tv.metrics.bias_error(own.estimate.values, own.truth.values)
    assert cell["rise_time"] == tv.metrics.rise_time(results.time.values, own.estimate.values)
    assert cell["coverage"] == pytest.approx(100 * own.covered.values.mean())
    assert cell["lowest_vaf"] == found.vaf.min()
    assert cell["failed"] == 0
    assert set(table.trials) == {3}
    sine = summarize(score(run(Study(**SMALL | {"stiffness": ["sine"]}), workers=1)))
    assert not {"rise_time", "switch_dip"} & set(sine.metric)
    assert "coverage" in set(sine.metric)


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
    repeated = [
        score(made_up(noisy(random, 40))).sel(scenario="cell", method_key="mine")
        for _ in range(100)
    ]
    told = {
        name: np.mean([float(one.standard_error.sel(metric=name)) for one in repeated])
        for name in METRICS
    }
    for name in ("bias_error", "debiased_bias_error", "random_error", "total_error", "coverage"):
        spread = np.std([float(one.value.sel(metric=name)) for one in repeated])
        assert told[name] == pytest.approx(spread, rel=0.3), name


def test_replicates_of_the_debiased_bias_are_centred_on_it(random):
    at = score(made_up(noisy(random, 30, spread=10.0, bias=3.0))).sel(metric="debiased_bias_error")
    assert float(at.replicates.mean()) == pytest.approx(
        at.value.item(), abs=0.25 * at.standard_error.item() + 0.05
    )
    plain = score(made_up(noisy(random, 30, spread=10.0, bias=3.0))).sel(metric="bias_error")
    assert float(plain.replicates.mean()) > plain.value.item() + 0.1


def test_one_trial_has_no_spread_and_no_standard_error(random):
    scores = score(made_up(noisy(random, 1)))
    assert np.isnan(scores.standard_error).all()
    assert np.isfinite(scores.value.sel(metric="bias_error")).all()
    assert np.isnan(scores.value.sel(metric=["random_error", "debiased_bias_error"])).all()


def test_draws_of_methods_are_paired_also_where_trials_failed(random):
    results = made_up(noisy(random, 10))
    both = xr.concat(
        [results, results.assign_coords(method_key=["other"])], "method_key", data_vars="all"
    )
    both = both.assign(truth=results.truth)
    failed = both.failure.values.astype(object)
    failed[0, 2:, 1] = "x"
    both["failure"] = (both.failure.dims, failed)
    scores = score(both.transpose("scenario", "trial", "method_key", ...))
    drawn = (
        np.random.default_rng(0)
        .multinomial(10, np.full(10, 0.1), size=scores.sizes["draw"])[:, :2]
        .any(axis=1)
    )
    known = np.isfinite(scores.replicates.sel(method_key="other", metric="total_error").values[0])
    np.testing.assert_array_equal(known, drawn)


def test_a_dip_at_the_switches_is_measured(random):
    over_time = np.full((4, 200), 95.0)
    over_time[:, 45:56] = over_time[:, 145:156] = 75.0
    at = score(made_up(noisy(random, 4), over_time)).sel(metric="switch_dip")
    assert at.value.item() == 20
    assert at.standard_error.item() < 1e-9


def test_spreads_where_the_joint_is_soft_and_stiff(random):
    soft = tv.simulate.SquareWave()(np.arange(200) / 100) < 100
    over_time = 90 + np.where(soft, 2.0, 1.0) * np.array([[-1.0], [1.0]])
    values = score(made_up(noisy(random, 2), over_time)).value
    assert values.sel(metric="time_varying_vaf_sd_soft").item() == 2
    assert values.sel(metric="time_varying_vaf_sd_stiff").item() == 1
    assert values.sel(metric="time_varying_vaf_sd").item() == 1.5


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
    covered = np.ones((4, 200))
    covered[1, :100] = np.nan
    covered[2, 100:150] = 0.0
    scores = score(made_up(noisy(random, 4), covered=covered))
    edges = np.where(np.isnan(covered), np.nan, covered - 1)
    expected = tv.metrics.coverage(edges, edges, np.zeros(200))
    assert expected == pytest.approx(100 * (1 - 50 / 700))
    assert scores.value.sel(metric="coverage").item() == pytest.approx(expected)
    covered[1] = np.nan
    scores = score(made_up(noisy(random, 4), covered=covered))
    assert scores.value.sel(metric="coverage").item() == pytest.approx(100 * (1 - 50 / 600))
    draws = scores.replicates.sel(metric="coverage").values.ravel()
    # A draw of the trial without a band alone, one of 256, tells nothing.
    assert np.isnan(draws).mean() == pytest.approx(1 / 256, abs=0.01)
    covered[:] = np.nan
    value = score(made_up(noisy(random, 4), covered=covered)).value
    assert np.isnan(value.sel(metric="coverage"))
