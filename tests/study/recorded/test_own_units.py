"""A quantity of one's own keeps its unit."""

import numpy as np

import tvsysid as tv
from tvsysid.study import Experiment, run, summarize


class Sloped(tv.Method):
    def fit(self, ensemble):
        estimates = dict(tv.ShortDataSegments().fit(ensemble).estimates)
        estimates["emg_slope"] = tv.Estimate(np.full(ensemble.samples, 3.0), "N m/V")
        estimates["ratio"] = tv.Estimate(np.full(ensemble.samples, 0.5), "")
        return tv.Model.of(ensemble, estimates=estimates)


def test_a_quantity_of_one_s_own_is_summarized_with_its_unit(small):
    settings = {"methods": [Sloped()], "realizations": 20, "bootstraps": 2}
    experiment = Experiment(virtual=1, perturbation="noise", **settings)
    results = run(experiment, prepared=small.prepared[:1], workers=1)
    assert str(results.unit.sel(quantity="emg_slope").values) == "N m/V"
    table = summarize(results).set_index("metric")
    slope, ratio = table.loc["emg_slope mean"], table.loc["ratio mean"]
    assert (slope.value, slope.unit) == (3.0, "N·m/V")
    assert (ratio.value, ratio.unit) == (0.5, "")
