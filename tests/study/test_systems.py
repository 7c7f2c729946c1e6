"""A study simulates any system, profile and perturbation, at any rate and period."""

import numpy as np
import pytest
from tests.conftest import realizations

import tvsysid as tv
from tvsysid.study import Study, read_results, run, score, summarize
from tvsysid.study.scores import from_switch

SHORT = {"duration_s": 20, "perturbation": "noise", "trials": 1, "methods": "birf"}


class Broken:
    def simulate(self, duration, **settings):
        raise RuntimeError("no such joint")


def test_a_system_as_an_object_and_one_that_fails():
    found = run(Study(**SHORT, system=tv.simulate.Joint(inertia=0.025)), workers=1)
    assert (found.truth.sel(quantity="inertia") == 0.025).all()
    with pytest.raises(tv.InputError, match=r"failed: RuntimeError: no such joint"):
        run(Study(**SHORT, system=Broken()), workers=1)


def test_seeds_do_not_depend_on_rate_and_period_but_on_the_system():
    usual, other, reflex = (
        study.seed_of(study.scenarios[0], 3).spawn_key
        for study in (Study(), Study(rate=50, period=1.0), Study(system="reflex"))
    )
    # As it was before a study could take other systems.
    assert usual == other == (4227018733, 870690802, 2055610964, 848547876, 3)
    assert usual != reflex


def test_parts_of_one_name_are_refused():
    soft, stiff = (lambda time: 50 + 0 * time), (lambda time: 150 + 0 * time)
    for settings in (
        {"stiffness": [soft, stiff]},
        {"stiffness": soft, "also": [{"stiffness": stiff}]},
    ):
        with pytest.raises(tv.InputError, match="stiffness: two objects have the same name"):
            Study(**settings, **SHORT)


def test_switches_are_those_of_a_truth_of_two_levels():
    time = np.arange(200) / 100
    wave, pulse = tv.simulate.SquareWave(), np.where((time >= 0.5) & (time < 1.0), 150.0, 50.0)
    np.testing.assert_allclose(from_switch(time, wave(time)), np.abs(time % 1 - 0.5), atol=1e-12)
    assert from_switch(time, pulse).max() == pytest.approx(0.75)
    assert np.isnan(from_switch(time, tv.simulate.SineWave()(time))).all()


class Halves(tv.Method):
    """Half of what another method predicts is intrinsic, half reflex."""

    pathway_names = ("intrinsic", "reflex")

    def fit(self, ensemble):
        model = tv.ShortDataSegments().fit(ensemble)

        def pathways(other):
            return dict.fromkeys(self.pathway_names, model.predict(other) / 2)

        return tv.Model.of(ensemble, estimates=model.estimates, pathways=pathways)


@pytest.mark.slow
def test_each_pathway_is_scored():
    found = run(
        Study(**SHORT | {"methods": [Halves(), "birf"], "trials": 2}, system="reflex"), workers=1
    )
    table = summarize(score(found))
    table = table[table.metric.str.endswith("pathway_vaf")]
    assert set(table.method) == {"Halves"}
    assert list(table.metric) == ["intrinsic pathway_vaf", "reflex pathway_vaf"]
    assert set(table.unit) == {"%"}
    expected = found.pathway_vaf.sel(method_key="Halves").mean("trial").values[0]
    np.testing.assert_allclose(table.value, expected)
    assert (table.standard_error > 0).all()


@pytest.mark.slow
def test_further_scenarios_may_have_methods_of_their_own(tmp_path):
    also = [{"duration_s": 12, "methods": ["sds", "eirf"]}, {"perturbation": "pulses"}]
    settings = SHORT | {"system": "reflex", "methods": ["birf", "sds"]}
    study = Study(**settings, also=also)
    asked = [["birf", "sds"], ["eirf", "sds"], ["birf", "sds"]]
    assert list(study.parts["methods"]) == ["birf", "sds", "eirf"]
    assert list(map(sorted, study.methods_of.values())) == asked
    run(study, tmp_path, workers=1)
    found = read_results(tmp_path)
    there = np.isfinite(found.vaf.sel(trial=0)).values
    np.testing.assert_array_equal(there, [[1, 1, 0], [0, 1, 1], [1, 1, 0]])
    np.testing.assert_array_equal(found.asked, there)
    assert not (found.failure.values != "").any()
    methods = summarize(score(found)).groupby("scenario", sort=False).method.unique()
    assert list(map(sorted, methods)) == asked
    alone = run(Study(**settings | also[0]), workers=1)
    own = found.estimate.isel(scenario=[1]).sel(method_key=["sds", "eirf"])
    np.testing.assert_array_equal(alone.estimate, own)


@pytest.mark.slow
def test_the_mean_over_realizations_is_subtracted_from_the_noiseless_torque_too():
    settings = SHORT | {"system": "reflex", "methods": [Halves()]}
    plain, without = (
        run(Study(**settings, subtract_mean=each), workers=1) for each in (False, True)
    )
    study = Study(**settings)
    simulation = tv.study.trials.simulate(study, study.scenarios[0], 0)
    ensemble = realizations(simulation.recording)
    model = tv.ShortDataSegments().identify(tv.preprocess.subtract_mean(ensemble))
    np.testing.assert_allclose(without.estimate.values[0, 0, 0, 0], model.stiffness)
    assert (without.vaf > plain.vaf).all()
