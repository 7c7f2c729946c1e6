"""The search for switches, and what adaptive finds of several."""

import attrs
import numpy as np
import pytest
from tests.methods.free_estimates import estimate_of

from tvsysid.methods.adaptive import averaging, evidence, prior, search
from tvsysid.methods.adaptive.model import switches_of


@pytest.mark.slow
def test_the_search_finds_stairs_of_which_no_step_alone_is_worth_much():
    axis, edges = prior.Axis(200, periodic=True), np.array([21.3, 57.7, 98.1, 133.4, 171.3])
    stairs = 1.0 + axis.steps(edges, recorded=True) @ [0.2, 0.2, 0.2, 0.2, -0.8]
    for seed in range(2, 5):
        values = stairs + 0.1 * np.random.default_rng(seed).normal(size=200)
        estimate = evidence.FreeEstimate(axis, values, np.eye(200) / 0.1, 1.0)
        smooths = [evidence.SmoothFit(estimate, each) for each in prior.smooth_priors(axis)[::8]]
        grid = search.Grid(estimate)
        sets = search.search_switches([search.first_model(each, grid) for each in smooths], grid)
        true = max(search.CurveModel(each, edges).refined().total for each in smooths)
        best = max(each.refined().total for each in sets)
        assert best > true - 0.5


def test_sums_of_few_harmonics_are_found_beside_switches(random):
    estimate, _ = estimate_of(random, periodic=True, times=80)
    turns = 2 * np.pi * np.arange(80) / 80
    waves = 0.3 * np.sin(turns) + 0.1 * np.cos(3 * turns)
    estimate = attrs.evolve(estimate, values=estimate.values + waves)
    second = list(evidence.few_harmonics(estimate, np.array([12.3, 27.8])))[1]
    assert list(np.flatnonzero(second.variances)) == [0, 2, 5]  # constant, first sine, third cosine
    best = averaging.average(estimate).models[0]
    np.testing.assert_allclose(best.positions, [12.3, 27.8], atol=0.3)
    assert list(np.flatnonzero(best.smooth.prior.variances)) == [0, 2, 5]


def test_misfit_widens_the_error_of_a_free_estimate_that_is_given_too_small(random):
    estimate, _ = estimate_of(random, periodic=True, times=200, switches=())
    small = attrs.evolve(estimate, whitener=3.0 * estimate.whitener)
    for given, expected in ((small, estimate), (estimate, estimate)):
        ratio = given.with_misfit().whitener[0, 0] / expected.whitener[0, 0]
        assert ratio == pytest.approx(1.0, abs=0.2)


def test_two_switches_that_are_close_are_both_listed(random):
    estimate, _ = estimate_of(random, periodic=False, switches=(20.3, 22.6))
    rows = switches_of("stiffness", averaging.average(estimate), 0, 1.0)
    times = [row.time for row in rows if row.probability > 0.5]
    assert times == pytest.approx([20.3, 22.6], abs=0.4)
