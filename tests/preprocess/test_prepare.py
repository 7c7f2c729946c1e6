import attrs
import numpy as np
import pytest
from tests.virtual import perfect, prepared, simulated

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
    ensemble, account, table = preparation.ensemble, preparation.account, preparation.account.table
    assert (len(preparation.recorded), preparation.recorded.left_out, len(table)) == (300, 0, 300)
    assert (ensemble.sampling_rate, ensemble.samples, ensemble.context) == (128.0, 256, 64)
    assert len(ensemble) + sum(account.counts.values()) == 300
    assert set(account.counts) == {"alignment", "task component", "residual"}
    np.testing.assert_allclose(ensemble.onsets, (account.onsets + account.shifts)[account.kept])
    np.testing.assert_array_equal(ensemble.trials, account.trials[account.kept])
    np.testing.assert_allclose(ensemble.torque.mean(axis=0), 0, atol=1e-12)
    excluded = table[table.excluded_by != ""]
    assert (excluded.reached > excluded.limit).all()
    assert table.reached[table.excluded_by == ""].isna().all()


@pytest.mark.slow
def test_survivors_are_as_many_as_in_the_paper():
    noise, prbs = (
        [len(prepared(number, which).ensemble) for number in PEOPLE] for which in PERTURBATIONS
    )
    assert abs(np.mean(noise) - 260) < 12
    assert abs(np.mean(prbs) - 255) < 14
    assert min(noise + prbs) > 215


@pytest.mark.slow
def test_exclusions_are_of_the_papers_kinds():
    late = {
        which: [prepared(n, which).account.counts.get("alignment", 0) for n in PEOPLE]
        for which in PERTURBATIONS
    }
    assert max(late["noise"]) <= 3
    assert 5 <= np.median(late["prbs"]) <= 40
    for which in PERTURBATIONS:
        for step, low, high in (("task component", 3, 20), ("residual", 10, 32)):
            counts = [prepared(number, which).account.counts[step] for number in PEOPLE]
            assert low <= np.mean(counts) <= high, (which, step, counts)


@pytest.mark.slow
def test_variance_accounted_for_is_near_the_papers():
    def mean_vaf(which):
        values = []
        for number in PEOPLE:
            drawn = next(
                tv.preprocess.bootstrap(prepared(number, which).ensemble, 1, seed=0, size=75)
            )
            values.append(
                tv.metrics.vaf(
                    drawn.torque[:, drawn.core], SDS.identify(drawn).predict(drawn)
                ).mean()
            )
        return np.mean(values)

    # The paper's 49 to 63 % and 75 to 87 % are over methods.
    assert 49 < mean_vaf("noise") < 65
    assert 74 < mean_vaf("prbs") < 87


@pytest.mark.slow
def test_all_of_a_perfect_persons_stiffness_is_found_before_alignment_and_less_after():
    for which in PERTURBATIONS:
        simulation = tv.simulate.Participant(1, perfect()).simulate(
            perturbation=tv.simulate.PERTURBATIONS[which]
        )
        preparation = tv.preprocess.prepare(simulation.recording)
        error, truth = stiffness_error(simulation, preparation.recorded)
        assert np.sqrt(np.mean(error**2)) < 0.01 * truth.mean()
        # Alignment takes a part of the answer for a delay: the bias that its notes tell of.
        aligned, _ = stiffness_error(simulation, preparation.alignment.ensemble)
        assert -0.18 < aligned.mean() / truth.mean() < -0.12


@pytest.mark.slow
@pytest.mark.parametrize("which", PERTURBATIONS)
def test_prepared_ensembles_identify_with_stiffness_near_the_truth(which):
    biases, unmoved_biases = [], []
    for number in PEOPLE:
        simulation, preparation = simulated(number, which), prepared(number, which)
        error, truth = stiffness_error(simulation, preparation.ensemble)
        assert np.corrcoef(truth, truth + error)[0, 1] > 0.8
        biases.append(error.mean())
        unmoved, _ = stiffness_error(
            simulation, preparation.recorded.select(preparation.account.kept)
        )
        unmoved_biases.append(unmoved.mean())
    # The paper's sequence underestimates everybody; the same realizations where they were recorded
    # do much less so.
    assert max(biases) < 0
    assert -25 < np.mean(biases) < -10
    assert abs(np.mean(unmoved_biases)) < 0.5 * abs(np.mean(biases))


@pytest.mark.slow
def test_the_recording_is_untouched_and_the_result_repeatable():
    recording = simulated(3).recording
    torque = recording.torque.copy()
    first, second = tv.preprocess.prepare(recording), tv.preprocess.prepare(recording)
    np.testing.assert_array_equal(recording.torque, torque)
    np.testing.assert_array_equal(first.ensemble.torque, second.ensemble.torque)
    np.testing.assert_array_equal(first.account.kept, second.account.kept)


def test_ends_too_short_for_the_context_cost_the_outer_realizations_and_it_is_counted():
    recording = simulated(1).recording
    # Context and search take 1 s: of each of the ten trials the first realization lacks it if 0.5 s
    # are cut off, and
    # the last one if nothing is left behind it.
    assert tv.preprocess.prepare(recording, ends=0.5).recorded.left_out == 10
    assert tv.preprocess.prepare(recording, ends=0.5, reference=None).recorded.left_out == 0


def test_steps_that_are_not_asked_for_are_not_taken():
    recording = simulated(1).recording
    prepare = tv.preprocess.prepare
    plain = prepare(recording, reference=None, task_limit=None, residual_limit=None)
    assert plain.steps == ()
    assert len(plain.recorded) == len(plain.ensemble) == 300
    assert plain.account.kept.all()
    assert plain.ensemble.context == 64
    np.testing.assert_allclose(plain.ensemble.torque.mean(axis=0), 0, atol=1e-9)
    unaligned = prepare(recording, reference=None)
    assert unaligned.steps == (unaligned.task, unaligned.residual)
    assert unaligned.account.counts.keys() == {"task component", "residual"}


def test_channels_pass_every_step():
    """An EMG that is a multiple of the torque stays one, and loses its mean where it is asked to."""
    recording = simulated(1, "noise").recording
    recording = attrs.evolve(
        recording,
        channels={
            **recording.channels,
            "emg": 0.1 * recording.torque,
            "posture": np.arange(len(recording)) / 1e3,
        },
    )
    ensemble = tv.preprocess.prepare(recording, channels=("emg",)).ensemble
    assert ensemble.mean_subtracted
    assert list(ensemble.channels) == ["target", "emg", "posture"]
    np.testing.assert_allclose(ensemble.channels["emg"], 0.1 * ensemble.torque, atol=1e-9)
    assert ensemble.channels["posture"].mean(axis=0).min() > 1
    drawn = next(tv.preprocess.bootstrap(ensemble, 1, seed=0))
    np.testing.assert_allclose(drawn.channels["emg"], 0.1 * drawn.torque, atol=1e-9)
    assert drawn.mean_subtracted


def test_a_wrong_name_of_a_channel_gets_those_that_are_there():
    recording = simulated(1, "noise").recording
    with pytest.raises(
        tv.InputError, match="no 'EMG'; the signals are 'angle', 'torque', 'target'"
    ):
        tv.preprocess.prepare(recording, channels=("EMG",))
