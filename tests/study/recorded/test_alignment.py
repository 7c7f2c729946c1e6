"""What aligning realizations to the target does to their stiffness."""

import attrs
import numpy as np
import pytest
from tests.virtual import simulated

import tvsysid as tv
from tvsysid.study import alignments, prepared_recordings
from tvsysid.study.alignment import UNKNOWN, effect_of_alignment


@pytest.mark.slow
def test_what_is_reported_is_what_is_lost():
    """For a virtual participant, whose truth is known."""
    sds = tv.ShortDataSegments(max_lag=15 / 128, window=12 / 128)
    for perturbation in ("noise", "prbs"):
        simulation = simulated(1, perturbation)
        preparation = tv.preprocess.prepare(simulation.recording)
        kept = preparation.recorded.select(preparation.kept)
        errors = []
        for ensemble in (preparation.ensemble, tv.preprocess.subtract_mean(kept)):
            truth = simulation.truth_of(ensemble)["stiffness"].mean(axis=0)
            errors.append(float(np.nanmean(sds.identify(ensemble).stiffness - truth)))
        effect = effect_of_alignment(preparation)
        assert effect.aligned - effect.unshifted == pytest.approx(errors[0] - errors[1], abs=0.1)
        assert -20 < effect.aligned - effect.unshifted < -2 * effect.standard_error
        assert 1 < effect.standard_error < 6


@pytest.mark.slow
def test_it_is_kept_with_the_results_and_read_again(small):
    table = alignments(small.results)
    assert list(table.recording) == ["P1-noise", "P1-prbs"]
    one, kept = table.iloc[0], small.prepared[0].alignment
    assert (one.aligned, one.unshifted, one.standard_error) == kept
    assert one.difference == kept.aligned - kept.unshifted
    assert one.percent == pytest.approx(100 * one.difference / kept.unshifted)


def test_without_shifts_nothing_is_reported(small):
    unshifted = tv.preprocess.prepare(simulated(1).recording, reference=None)
    assert effect_of_alignment(unshifted) is UNKNOWN
    settings = {"perturbation": "noise", "preparation": {"reference": None}}
    (item,) = prepared_recordings(attrs.evolve(small.experiment, **settings))
    assert np.isnan(item.alignment).all()
