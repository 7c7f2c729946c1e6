"""Against plain, slow versions that share no code with the package."""

import math

import numpy as np
import pytest
from benchmarks import plain
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.numerics.bases import evaluate
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate

DEGREE = math.degrees(1.0)  # what gamma counts in here: 1 N·m/deg, in N·m/rad

contexts = pytest.mark.parametrize("context", [0.5, 0.14, 0.0])
perturbations = pytest.mark.parametrize("perturbation", ["noise", "prbs"])


def agree(found, expected, tolerance):
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    assert np.nanmax(np.abs(found - expected)) < tolerance * np.nanmax(np.abs(expected))


@contexts
@pytest.mark.parametrize("perturbation", ["noise", pytest.param("prbs", marks=pytest.mark.slow)])
def test_impulse_responses(perturbation, context):
    ensemble = ensemble_of(150.0, "square", perturbation, context=context)
    data = ensemble.angle, ensemble.torque, ensemble.context, 12
    agree(tv.EnsembleIRF().identify(ensemble).impulse_response, plain.eirf(*data, rate=100.0), 1e-8)
    found = tv.ShortDataSegments().identify(ensemble).impulse_response
    agree(found, plain.sds(*data, half=5, rate=100.0), 1e-8)
    functions = evaluate(tv.CubicBSplines(10), 200)
    found = tv.BasisIRF(model="irf", prior="none").identify(ensemble).impulse_response
    agree(found, plain.birf_irf(*data, basis_values=functions, rate=100.0), 1e-7)


@contexts
@pytest.mark.parametrize("length", [30, 31])
def test_frequency_response(context, length):
    ensemble = ensemble_of(60.0, "square", "prbs", context=context)
    found = tv.EnsembleSpectral(window=length / 100).identify(ensemble).frequency_response
    agree(found, plain.esm(ensemble.angle, ensemble.torque, ensemble.context, length), 1e-9)


@perturbations
def test_parametric_regression(perturbation):
    ensemble = ensemble_of(60.0, "square", perturbation)
    reach = slice(ensemble.context - HALF_WIDTH, ensemble.context + 200 + HALF_WIDTH)
    signals = differentiate(ensemble.angle[:, reach], 100.0)
    expected = plain.birf_parametric(
        *signals, ensemble.torque[:, ensemble.core], evaluate(tv.CubicBSplines(10), 200)
    )
    model = tv.BasisIRF(prior="none").identify(ensemble)
    for found, values in zip(
        (model.stiffness, model.viscosity, model.inertia), expected, strict=True
    ):
        np.testing.assert_allclose(found, values, rtol=1e-8)


def kernel_solutions(ensemble, method, l2, noise_variance=None):
    """Fast model, and the dense solution as means over realizations."""
    model = method.identify(ensemble)
    signals = differentiate(plain.join(ensemble.angle, ensemble.context, HALF_WIDTH), 100.0)
    dense = plain.kbr_dense(
        *signals,
        plain.join(ensemble.torque, ensemble.context),
        rate=100.0,
        period=2.0,
        l1=method.length_periodic,
        l2=l2,
        gamma=method.gamma,
        band=method.band,
        noise_variance=noise_variance,
    )
    return model, dense


def mean_over_realizations(values):
    return values.reshape(-1, 200).mean(axis=0)


@pytest.mark.slow
@perturbations
@pytest.mark.parametrize(
    ("method", "l2"),
    [
        (tv.KernelRegression(scale=DEGREE), math.inf),
        (
            tv.KernelRegression(
                length_periodic=np.exp(-1), length_decay=30.0, gamma=13.8, scale=DEGREE
            ),
            30.0,
        ),
        (tv.KernelRegression(length_decay=10.0, band=(0.5, 15.0), scale=DEGREE), 10.0),
    ],
)
def test_low_rank_kernel_regression_equals_the_dense_one(monkeypatch, perturbation, method, l2):
    ensemble = ensemble_of(12.0, "square", perturbation)
    # As it comes: within a few thousandths of N·m/rad.
    model, dense = kernel_solutions(ensemble, method, l2)
    assert np.abs(model.stiffness - mean_over_realizations(dense.stiffness)).max() < 0.01
    assert model.diagnostics.details["noise_variance"] == pytest.approx(
        dense.noise_variance, rel=1e-4
    )
    # With every feature that rounding leaves, however faint: the same.
    monkeypatch.setattr("tvsysid.methods.kbr.kernel.TOLERANCE", 1e-15)
    variance = method.identify(ensemble).diagnostics.details["noise_variance"]
    model, dense = kernel_solutions(ensemble, method, l2, variance)
    agree(model.stiffness, mean_over_realizations(dense.stiffness), 1e-6)
    agree(model.viscosity, mean_over_realizations(dense.viscosity), 1e-5)
    agree(model.inertia, mean_over_realizations(dense.inertia), 3e-4)
