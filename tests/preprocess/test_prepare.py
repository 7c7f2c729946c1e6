import attrs
import numpy as np
import pytest
from tests.virtual import prepared, simulated

import tvsysid as tv

SDS = tv.ShortDataSegments(max_lag=15 / 128, window=12 / 128)
PEOPLE = range(1, 7)
PERTURBATIONS = ("noise", "prbs")


def stiffness_error(simulation, ensemble):
    """Identified less true mean stiffness in N·m/rad, shape (time,), and the true one."""
    centred = tv.preprocess.subtract_mean(ensemble)
    truth = simulation.truth_of(centred)["stiffness"].mean(axis=0)
    return SDS.identify(centred).stiffness - truth, truth


def test_the_sequence_accounts_for_all_300_realizations():
    preparation = prepared(1, "noise")
    ensemble, table, kept = preparation.ensemble, preparation.table, preparation.kept
    assert (len(preparation.recorded), preparation.recorded.left_out, len(table)) == (300, 0, 300)
    assert (ensemble.sampling_rate, ensemble.samples, ensemble.context) == (128.0, 256, 64)
    assert set(table.excluded_by) == {"", "alignment", "task component", "residual"}
    np.testing.assert_allclose(ensemble.onsets, (table.onset_s + table.shift_s)[kept])
    np.testing.assert_array_equal(ensemble.trials, table.trial[kept])
    for name, step in preparation.steps.items():
        assert np.sum(~step.kept) == np.sum(table.excluded_by == name)
    np.testing.assert_allclose(ensemble.torque.mean(axis=0), 0, atol=1e-12)
    excluded = table[~kept]
    assert (excluded.reached > excluded.limit).all()
    np.testing.assert_array_equal(excluded.unit == "s", excluded.excluded_by == "alignment")
    assert table.reached[kept].isna().all()
    assert f"{kept.sum()} of 300 realizations kept; excluded: " in repr(preparation)


@pytest.mark.slow
@pytest.mark.parametrize(("which", "survivors", "slack"), [("noise", 260, 12), ("prbs", 255, 14)])
def test_exclusions_are_like_those_of_the_paper(which, survivors, slack):
    preparations = [prepared(number, which) for number in PEOPLE]
    kept = [len(each.ensemble) for each in preparations]
    assert abs(np.mean(kept) - survivors) < slack
    assert min(kept) > 215
    late, task, residual = np.transpose(
        [[np.sum(~step.kept) for step in each.steps.values()] for each in preparations]
    )
    assert max(late) <= 3 if which == "noise" else 5 <= np.median(late) <= 40
    assert 3 <= np.mean(task) <= 20
    assert 10 <= np.mean(residual) <= 32


@pytest.mark.slow
@pytest.mark.parametrize(("which", "low", "high"), [("noise", 49, 65), ("prbs", 74, 87)])
def test_variance_accounted_for_is_near_the_papers(which, low, high):
    values = []
    for number in PEOPLE:
        drawn = next(tv.preprocess.bootstrap(prepared(number, which).ensemble, 1, seed=0, size=75))
        predicted = SDS.identify(drawn).predict(drawn)
        values.append(tv.metrics.vaf(drawn.torque[:, drawn.core], predicted).mean())
    assert low < np.mean(values) < high  # over methods, 49 to 63 % and 75 to 87 % in the paper


@pytest.mark.slow
@pytest.mark.parametrize("which", PERTURBATIONS)
def test_prepared_ensembles_identify_with_stiffness_near_the_truth(which):
    biases, unmoved_biases = [], []
    for number in PEOPLE:
        simulation, preparation = simulated(number, which), prepared(number, which)
        error, truth = stiffness_error(simulation, preparation.ensemble)
        assert np.corrcoef(truth, truth + error)[0, 1] > 0.8
        biases.append(error.mean())
        unmoved, _ = stiffness_error(simulation, preparation.recorded.select(preparation.kept))
        unmoved_biases.append(unmoved.mean())
    # The shifts lower everybody's stiffness; the same realizations without them are less biased.
    assert max(biases) < 0
    assert -25 < np.mean(biases) < -10
    assert abs(np.mean(unmoved_biases)) < 0.5 * abs(np.mean(biases))


def test_realizations_near_short_ends_are_left_out_and_counted():
    recording = simulated(1).recording
    # Context and search take 1 s. The first realization of each of the ten trials lacks it.
    assert tv.preprocess.prepare(recording, ends=0.5).recorded.left_out == 10
    assert tv.preprocess.prepare(recording, ends=0.5, reference=None).recorded.left_out == 0


def test_steps_can_be_left_out_and_channels_pass_the_others():
    recording = simulated(1).recording
    emg, posture = 0.1 * recording.torque, np.arange(len(recording)) / 1e3
    recording = attrs.evolve(recording, channels={"emg": emg, "posture": posture})
    settings = {"reference": None, "task_limit": None, "residual_limit": None}
    plain = tv.preprocess.prepare(recording, **settings, channels=("emg",))
    assert not plain.steps
    assert len(plain.recorded) == len(plain.ensemble) == plain.kept.sum() == 300
    channels = plain.ensemble.channels
    np.testing.assert_allclose(channels["emg"], 0.1 * plain.ensemble.torque, atol=1e-9)
    assert channels["posture"].mean(axis=0).min() > 1
    some = tv.preprocess.prepare(recording, reference=None)
    assert list(some.steps) == ["task component", "residual"]
    with pytest.raises(tv.InputError, match="there is no 'EMG'; the signals are 'angle', 'torque'"):
        tv.preprocess.prepare(recording, reference=None, channels=("EMG",))
