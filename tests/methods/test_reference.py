"""Against what the methods' authors' own code makes of the same data."""

import numpy as np
import pytest

import tvsysid as tv
from tvsysid.numerics import bases


def relative(values, expected):
    return np.abs(values - expected).max() / np.abs(expected).max()


@pytest.fixture
def ensemble(reference):
    return tv.Ensemble(reference["angle"], reference["torque"], float(reference["sampling_rate"]))


@pytest.fixture
def wrapped(reference):
    """Return realizations joined, the last one before the first and the first one after the last.

    The reference's basis method uses these.
    """

    def with_context(values):
        joined = np.concatenate([values.ravel()[-12:], values.ravel(), values.ravel()[:12]])
        return np.stack([joined[i : i + 224] for i in range(0, values.size, 200)])

    return tv.Ensemble(
        with_context(reference["angle"]), with_context(reference["torque"]), 100.0, context=12
    )


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        ({"solver": "mdl"}, "eirf_mdl"),
        ({"solver": "mdl", "order": "output"}, "eirf_mdl_sorted"),
        ({"solver": "full"}, "eirf_corr"),
        ({"solver": "full"}, "eirf_lstsq"),
    ],
)
def test_ensemble_irf_equals_the_reference(reference, ensemble, settings, name):
    model = tv.EnsembleIRF(**settings).identify(ensemble)
    first = int(reference["eirf_first_sample"])
    rows = slice(first, 200 - first)
    assert relative(model.impulse_response[rows], reference[f"{name}_irf"]) < 1e-9
    assert np.isnan(model.impulse_response[:first]).all()
    assert np.isnan(model.impulse_response[200 - first :]).all()
    np.testing.assert_allclose(model.lags, reference["lags"], atol=1e-12)
    if f"{name}_rank" in reference:
        np.testing.assert_array_equal(model.diagnostics.rank[rows], reference[f"{name}_rank"])


@pytest.mark.parametrize(("prior", "name"), [("ridge", "birf_irf_bayes"), ("none", "birf_irf_ols")])
def test_basis_irf_equals_the_reference(reference, wrapped, prior, name):
    model = tv.BasisIRF(model="irf", prior=prior).identify(wrapped)
    assert relative(model.impulse_response, reference[name]) < 1e-6
    if prior == "ridge":
        assert model.diagnostics.details["noise_variance"] == pytest.approx(
            float(reference["birf_noise_variance"]), rel=1e-3
        )


def test_bases_equal_the_reference(reference):
    cubic = bases.evaluate(bases.CubicBSplines(10), 200)
    np.testing.assert_allclose(cubic, reference["basis_clamped_cubic"], atol=1e-12)
    # The reference's bumps are as wide as they are apart, and scaled for time in s, here 0 to 1.99.
    gaussian = bases.evaluate(bases.GaussianBumps(10, width=1 / 9), 200) / np.sqrt(1.99)
    np.testing.assert_allclose(gaussian, reference["basis_gaussian"], atol=1e-12)
