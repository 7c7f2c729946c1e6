"""Test what a trial says of the bands of methods from other authors.

These bands are known to hold the truth always or never.
"""

import dataclasses

import numpy as np
import pytest
from scipy import stats

import tvsysid as tv
from tvsysid.study import Study, of_quantity, run, score, summarize

TIMES = 200


@dataclasses.dataclass(frozen=True)
class Banded(tv.Method):
    """Says that stiffness, which is 50 and 150 N·m/rad in turn, lies between two values.

    So at the first times only.
    """

    low: float
    high: float
    told: int = TIMES

    def fit(self, ensemble):
        width = np.where(np.arange(TIMES) < self.told, (self.high - self.low) / 2, np.nan)
        error = tv.StandardError(width / stats.norm.ppf(0.975), np.inf)
        return model_of(ensemble, np.full(TIMES, (self.low + self.high) / 2), error)


def model_of(ensemble, stiffness, error=None):
    def pathways(other):
        return {"intrinsic": 100.0 * other.angle[:, other.core]}

    estimates = {"stiffness": tv.Estimate(stiffness, "N m/rad", error=error)}
    return tv.Model.of(ensemble, estimates=estimates, pathways=pathways)


class Bandless(Banded):
    def fit(self, ensemble):
        return model_of(ensemble, np.full(TIMES, 100.0))


METHODS = {
    "always": (Banded(0.0, 200.0), 100.0),
    "never": (Banded(200.0, 300.0), 0.0),
    "where soft": (Banded(0.0, 100.0), 50.0),
    "at first": (Banded(0.0, 200.0, told=20), 100.0),
    "no band": (Bandless(0.0, 200.0), np.nan),
}


@pytest.fixture(scope="module")
def results():
    methods = [method for method, _ in METHODS.values()]
    study = Study(duration_s=20.0, trials=2, perturbation="prbs", methods=methods)
    return run(study, workers=1)


def of(results, name):
    return results.sel(quantity="stiffness").isel(scenario=0, method_key=list(METHODS).index(name))


@pytest.mark.parametrize("name", METHODS)
def test_the_share_of_known_bands(results, name):
    table = summarize(score(results))
    label = str(of(results, name).method_key.values)
    told = of_quantity(table[table.method == label]).set_index("metric").value
    assert told["failed"] == 0
    np.testing.assert_equal(told["coverage"], METHODS[name][1])


def test_it_is_told_of_each_time_and_is_nan_where_there_is_no_band(results):
    truth = results.truth.sel(quantity="stiffness").values[0]
    assert (of(results, "always").covered == 1).all()
    np.testing.assert_array_equal(of(results, "where soft").covered, np.tile(truth <= 100, (2, 1)))
    at_first = of(results, "at first").covered.values
    np.testing.assert_array_equal(
        at_first, np.tile(np.where(np.arange(TIMES) < 20, 1.0, np.nan), (2, 1))
    )
    assert np.isnan(of(results, "no band").covered).all()
