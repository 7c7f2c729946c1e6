"""From bootstraps to figures."""

import numpy as np
import pytest

import tvsysid as tv
from tvsysid.study import stiffness_over_time, summarize


def test_every_figure_is_as_defined(small):
    results = small.results
    labels = ["participant", "perturbation", "method", "realizations", "metric"]
    table = summarize(results).set_index(labels).value
    at = results.sel(recording="P1-prbs", analysis="esm-20")
    truth = results.truth.sel(quantity="stiffness").sel(recording="P1-prbs").values
    key = ("P1", "prbs", "esm", 20)
    assert table[*key, "mean_stiffness"] == pytest.approx(
        float(at.estimate.sel(quantity="stiffness").mean())
    )
    assert table[*key, "random_error"] == pytest.approx(
        np.sqrt(at.estimate.sel(quantity="stiffness").values.var(axis=0, ddof=1).mean())
    )
    assert table[*key, "vaf"] == pytest.approx(float(at.vaf.mean()))
    assert table[*key, "bandpassed_vaf"] == pytest.approx(float(at.bandpassed_vaf.mean()))
    assert table[*key, "lowest_time_varying_vaf"] == pytest.approx(
        float(at.time_varying_vaf.mean("bootstrap").min())
    )
    assert table[*key, "bias_error"] == pytest.approx(
        tv.metrics.bias_error(at.estimate.sel(quantity="stiffness").values, truth)
    )
    assert table[*key, "mean_bias"] == pytest.approx(
        float((at.estimate.sel(quantity="stiffness").mean("bootstrap") - truth).mean())
    )


def test_stiffness_over_time_has_mean_and_spread(small):
    table = stiffness_over_time(small.results)
    assert list(table.columns) == [
        *("participant", "perturbation", "method", "realizations", "time_s"),
        *("stiffness", "standard_deviation", "time_varying_vaf"),
    ]
    assert len(table) == 2 * 6 * 256
    rows = table[
        (table.perturbation == "noise") & (table.method == "birf") & (table.realizations == 10)
    ]
    at = small.results.sel(recording="P1-noise", analysis="birf-10", quantity="stiffness").estimate
    np.testing.assert_allclose(rows.stiffness, at.mean("bootstrap"))
    np.testing.assert_allclose(rows.standard_deviation, at.std("bootstrap", ddof=1))
    np.testing.assert_allclose(rows.time_s, small.results.time)


def test_people_have_no_bias_that_is_known(small):
    results = small.results.assign(truth=small.results.truth * np.nan)
    assert not {"bias_error", "mean_bias"} & set(summarize(results).metric)
