"""Test that one's own methods, systems, profiles and perturbations take part in studies."""

import numpy as np
import pytest
from tests.contracts.test_toys import ERROR, SYSTEMS, every_toy
from tests.contracts.toys import Cascade, Instrumental, Scheduled

import tvsysid as tv
from tvsysid.report import problems


def study_of(toy, **changes):
    settings = {"stiffness": "sine", "perturbation": "noise", "duration_s": 60, "trials": 2}
    settings |= {"system": SYSTEMS[toy], "methods": [toy(), "sds"]} | changes
    return tv.study.Study(**settings)


@every_toy
def test_takes_part_in_a_benchmark(toy, tmp_path):
    tv.study.run(study_of(toy), folder=tmp_path, workers=1)
    results = tv.study.read_results(tmp_path)
    assert not (results.failure != "").any()
    own, other = (results.isel(scenario=0).sel(method_key=key) for key in (toy.__name__, "sds"))
    truth = results.truth if "trial_truth" not in results else results.trial_truth
    for name in toy.names:
        found = own.estimate.sel(quantity=name)
        error = np.sqrt(np.nanmean((found - truth.isel(scenario=0).sel(quantity=name)) ** 2))
        assert error < 1.5 * ERROR[name], name
    assert (own.vaf > 80).all()
    if toy is Cascade:
        assert (own.pathway_vaf > 80).all()
        assert np.isnan(other.pathway_vaf).all()  # it has one
    if toy in (Cascade, Instrumental):
        assert np.isfinite(own.covered.sel(quantity="stiffness")).all()
    table = tv.study.summarize(tv.study.score(results))
    scored = table[(table.method == toy.__name__) & (table.metric == "total_error")]
    assert np.isfinite(scored.value).all()


@pytest.mark.parametrize("toy", [Scheduled, Instrumental])
def test_is_skipped_with_the_reason_where_its_channel_is_missing(toy):
    results = tv.study.run(study_of(toy, system="joint", trials=1), workers=1)
    (problem,) = problems(results)
    assert (problem["method"], problem["kind"], problem["count"]) == (toy.__name__, "skipped", 1)
    assert problem["first"].startswith("it needs the channel")
    assert (results.failure == "").all()
    assert np.isnan(results.estimate.sel(method_key=toy.__name__)).all()


@pytest.mark.slow
@every_toy
def test_takes_part_in_an_experiment(toy, tmp_path):
    simulation = SYSTEMS[toy].simulate(
        100, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=3
    )
    tv.recordings.write_recording(tmp_path / "ankle.nc", simulation.recording)
    experiment = tv.study.Experiment(
        folder=tmp_path,
        participants={"P1": {"noise": "ankle.nc"}},
        reading={"angle": "angle", "torque": "torque", "sampling_rate": 1000.0}
        | {"channels": {item.name: item.name for item in toy.inputs}},
        preparation={
            "reference": None,
            "rate": 100.0,
            "period": 2,
            "task_limit": None,
            "residual_limit": None,
        },
        methods=[toy(), "sds"],
        realizations=40,
        bootstraps=3,
    )
    tv.study.run(experiment, folder=tmp_path, workers=1)
    results = tv.study.read_results(tmp_path)
    assert not (results.failure != "").any()
    own = results.isel(recording=0, analysis=0)
    assert str(own.method_key.item()) == toy.__name__
    for name in toy.names:
        assert np.isfinite(own.estimate.sel(quantity=name)).mean() > 0.9
    assert (own.vaf > 80).all()
    assert "pathway_vaf" not in results  # of a recording, nobody knows the pathways' torques


@pytest.mark.slow
def test_the_truth_of_a_virtual_participant_is_in_no_method_s_way():
    experiment = tv.study.Experiment(
        virtual=1, perturbation="prbs", methods=[Cascade(), "sds"], realizations=40, bootstraps=2
    )
    (prepared,) = tv.study.prepared_recordings(experiment)
    assert set(prepared.ensemble.channels) == {"target"}
    table = tv.study.summarize(tv.study.run(experiment, prepared=[prepared], workers=1))
    assert "reflex_gain random_error" in set(table[table.method == "Cascade"].metric)
