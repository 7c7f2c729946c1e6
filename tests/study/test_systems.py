"""A study simulates any system, profile and perturbation, at any rate and period."""

import numpy as np
import pytest

import tvsysid as tv
from tvsysid.study import Study, read_results, run, score, summarize
from tvsysid.study.scores import from_switch


class Broken:
    def simulate(self, duration, **settings):
        raise RuntimeError("no such joint")


def test_a_system_as_an_object_and_one_that_fails():
    joint = tv.simulate.Joint(inertia=0.025)
    found = run(
        Study(system=joint, duration_s=8, trials=1, perturbation="prbs", methods="birf"), workers=1
    )
    assert (found.truth.sel(quantity="inertia") == 0.025).all()
    with pytest.raises(tv.InputError, match=r"failed: RuntimeError: no such joint"):
        run(Study(system=Broken(), duration_s=8, trials=1, methods="birf"), workers=1)


def test_seeds_do_not_depend_on_rate_and_period_but_on_the_system():
    usual, other = Study(), Study(rate=50, period=1.0)
    assert (
        usual.seed_of(usual.scenarios[0], 3).spawn_key
        == other.seed_of(other.scenarios[0], 3).spawn_key
    )
    reflex = Study(system="reflex")
    assert (
        usual.seed_of(usual.scenarios[0], 3).spawn_key
        != reflex.seed_of(reflex.scenarios[0], 3).spawn_key
    )
    # As it was before a study could take other systems.
    assert usual.seed_of(usual.scenarios[0], 3).spawn_key == (
        4227018733,
        870690802,
        2055610964,
        848547876,
        3,
    )


def test_a_truth_that_changes_from_trial_to_trial_is_scored_by_trial():
    study = Study(
        system="scheduled",
        stiffness="sine",
        duration_s=20,
        trials=3,
        perturbation="prbs",
        methods="birf",
    )
    found = run(study, workers=1)
    truth = found.trial_truth.sel(quantity="stiffness").values[0]
    assert np.ptp(truth, axis=0).max() > 0.1
    scores = score(found)
    off = found.estimate.sel(quantity="stiffness").values[0, :, 0] - truth
    assert scores.value.sel(metric="total_error").item() == pytest.approx(np.sqrt(np.mean(off**2)))


class Levels:
    """Levels in turn, each for some seconds; named as it is told."""

    def __init__(self, seconds, *levels, name="Levels"):
        self.seconds, self.levels, self.name = seconds, np.array(levels), name

    def __call__(self, time):
        return self.levels[
            np.floor(np.asarray(time) / self.seconds + 1e-9).astype(int) % len(self.levels)
        ]

    def __repr__(self):
        return self.name


SHORT = {"perturbation": "noise", "trials": 1, "methods": "birf"}


def test_the_truth_is_that_of_each_scenario_s_own_duration():
    study = Study(stiffness=Levels(60, 50.0, 150.0), duration_s=[60, 120], **SHORT)
    truth = run(study, workers=1).truth.sel(quantity="stiffness").mean("time")
    np.testing.assert_allclose(truth, [50, 100])


def test_parts_of_one_name_are_refused():
    soft, stiff = (lambda time: 50 + 0 * time), (lambda time: 150 + 0 * time)
    with pytest.raises(tv.InputError, match="stiffness: two objects have the same name"):
        Study(stiffness=[soft, stiff], **SHORT)
    with pytest.raises(tv.InputError, match="stiffness: two objects have the same name"):
        Study(stiffness=soft, also=[{"stiffness": stiff}], **SHORT)


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
    methods = [Halves(), "birf"]
    found = run(
        Study(system="reflex", duration_s=20, **SHORT | {"methods": methods, "trials": 2}),
        workers=1,
    )
    table = summarize(score(found))
    table = table[table.metric.str.endswith("pathway_vaf")].set_index(["method", "metric"])
    assert list(table.index) == [
        ("Halves", "intrinsic pathway_vaf"), ("Halves", "reflex pathway_vaf")
    ]  # fmt: skip
    assert set(table.unit) == {"%"}
    expected = found.pathway_vaf.sel(method_key="Halves").mean("trial").values[0]
    np.testing.assert_allclose(table.value, expected)
    assert (table.standard_error > 0).all()


@pytest.mark.slow
def test_further_scenarios_may_have_methods_of_their_own(tmp_path):
    also = [{"duration_s": 12, "methods": ["sds", "eirf"]}, {"perturbation": "pulses"}]
    study = Study(system="reflex", duration_s=20, **SHORT | {"methods": ["birf", "sds"]}, also=also)
    assert list(study.named_methods) == ["birf", "sds", "eirf"]
    assert list(map(sorted, study.methods_of.values())) == [
        ["birf", "sds"],
        ["eirf", "sds"],
        ["birf", "sds"],
    ]
    run(study, tmp_path, workers=1)
    found = read_results(tmp_path)
    there = np.isfinite(found.vaf.sel(trial=0)).values
    np.testing.assert_array_equal(
        there, [[True, True, False], [False, True, True], [True, True, False]]
    )
    np.testing.assert_array_equal(found.asked, there)
    assert not (found.failure.values != "").any()
    table = summarize(score(found))
    assert {name: set(rows.method) for name, rows in table.groupby("duration_s")} == {
        20.0: {"birf", "sds"},
        12.0: {"sds", "eirf"},
    }
    alone = run(Study(system="reflex", duration_s=12, **SHORT | {"methods": ["sds"]}), workers=1)
    np.testing.assert_array_equal(
        alone.estimate.values.squeeze(),
        found.estimate.isel(scenario=1).sel(method_key="sds").values.squeeze(),
    )


@pytest.mark.slow
def test_the_mean_over_realizations_is_subtracted_from_the_noiseless_torque_too():
    settings = {
        "system": "reflex",
        "duration_s": 20,
        "perturbation": "noise",
        "trials": 1,
        "methods": [Halves()],
    }
    plain, without = (
        run(Study(**settings, subtract_mean=each), workers=1) for each in (False, True)
    )
    study = Study(**settings)
    seed = study.seed_of(study.scenarios[0], 0)
    simulation = study.parts["system reflex"].simulate(
        20, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=seed
    )
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), 2.0)
    model = tv.ShortDataSegments().identify(tv.preprocess.subtract_mean(ensemble))
    np.testing.assert_allclose(without.estimate.values[0, 0, 0, 0], model.stiffness)
    assert not np.allclose(plain.estimate, without.estimate, equal_nan=True)
    assert "subtract_mean" in Study(**settings, subtract_mean=True).to_json()
