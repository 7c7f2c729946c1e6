"""What a second-order fit leaves unexplained, against a slow version."""

import warnings

import attrs
import numpy as np
import pytest
from scipy.signal import lfilter
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.numerics.bases import CubicBSplines
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate


def with_reflex(ensemble, share):
    """Add torque of velocity 40 ms ago through a low-pass of 2.5 Hz.

    Its RMS is ``share`` of the torque's.
    """
    pole = np.exp(-2 * np.pi * 2.5 / ensemble.sampling_rate)
    late = round(0.04 * ensemble.sampling_rate)
    reflex = lfilter([1 - pole], [1, -pole], np.gradient(ensemble.angle, axis=1), axis=1)
    reflex = np.pad(reflex, ((0, 0), (late, 0)))[:, :-late]
    return attrs.evolve(
        ensemble, torque=ensemble.torque + share * ensemble.torque.std() / reflex.std() * reflex
    )


def test_agreement_is_what_a_regression_on_lagged_angles_leaves():
    ensemble = with_reflex(ensemble_of(40.0, "sine", "prbs"), 0.5)
    with pytest.warns(tv.DataQualityWarning, match="not of second order"):
        model = tv.BasisIRF().identify(ensemble)
    whole = slice(ensemble.context - HALF_WIDTH, ensemble.context + ensemble.samples + HALF_WIDTH)
    signals = differentiate(ensemble.angle[:, whole], ensemble.sampling_rate)
    impedance = np.stack([model.stiffness, model.viscosity, model.inertia])
    fit = np.einsum("mt,mrt->rt", impedance, signals)
    left = ensemble.torque[:, ensemble.core] - fit
    lags = range(-HALF_WIDTH, HALF_WIDTH + 1)
    lagged = np.stack(
        [
            ensemble.angle[
                :, ensemble.context - lag : ensemble.context - lag + ensemble.samples
            ].ravel()
            for lag in lags
        ]
    )
    weights = np.linalg.lstsq(lagged.T, left.ravel(), rcond=1e-6)[0]
    beyond = np.mean((weights @ lagged) ** 2) - len(lagged) * np.mean(left**2) / left.size
    expected = 100 * (1 - beyond / (np.mean(fit**2) + np.mean((weights @ lagged) ** 2)))
    assert model.diagnostics.details["second_order_agreement"] == pytest.approx(expected, abs=0.1)
    assert expected < 95


def test_what_a_fit_leaves_by_smoothing_has_no_mean_response():
    ensemble = ensemble_of(150.0, "square", "noise")
    coarse = tv.BasisIRF(basis=CubicBSplines(4)).identify(ensemble)
    assert tv.metrics.vaf(ensemble.torque[:, ensemble.core], coarse.predict(ensemble)).mean() < 90
    assert coarse.diagnostics.details["second_order_agreement"] > 99


def told_of(method, ensemble):
    """Return the agreement, and whether a warning denies a second-order joint."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        details = method.identify(ensemble).diagnostics.details
    told = any("not of second order" in str(item.message) for item in caught)
    return details["second_order_agreement"], told


@pytest.mark.parametrize("method", [tv.EnsembleIRF(), tv.ShortDataSegments()])
def test_noise_is_no_higher_order(method):
    ensembles = [
        tv.preprocess.subtract_mean(ensemble_of(110.0, "sine", "prbs", 0.0, seed=seed))
        for seed in range(8)
    ]
    agreements, told = np.array([told_of(method, ensemble) for ensemble in ensembles]).T
    assert not told.any()
    # The chosen rank takes the noise that suits it; nothing is lost to that.
    assert agreements.min() > 99
    with_reflexes = [told_of(method, with_reflex(ensemble, 0.6)) for ensemble in ensembles[:3]]
    assert all(told for _, told in with_reflexes)
