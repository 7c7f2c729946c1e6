"""Structural decomposition by subspaces: simulated joints, real ones, and the authors' own code."""

import numpy as np
import pytest
from numpy.polynomial.chebyshev import chebval
from scipy.io import loadmat
from scipy.signal import decimate
from tests.reflexive import ANKLES, centred, reflexive

import tvsysid as tv
from tvsysid.numerics import subspace
from tvsysid.numerics.bases import chebyshev_of
from tvsysid.numerics.stretch import recorded_velocity

pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


def constant(duration=60.0, gain=8.0, **settings):
    """Ensemble of a constant joint at 20 dB, less its mean."""
    settings = {"snr_db": 20, "seed": 1, **settings}
    return centred(reflexive(duration, stiffness="constant", gain=gain, **settings)[0])


@pytest.mark.parametrize(
    "muscle", [ANKLES[0], *(pytest.param(each, marks=pytest.mark.slow) for each in ANKLES[1:])]
)
def test_it_agrees_with_the_authors_code(recordings_folder, parallel_reference, muscle):
    lags, name = 4, f"{muscle}__sdss_rank_revealing_40ms_"
    recorded = loadmat(recordings_folder / "tonic_ankle.mat")
    angle, torque = (recorded[f"{muscle}_{signal}"][:, 0] for signal in ("angle", "torque"))
    velocity = recorded_velocity(angle[None, :, None], 1000.0)[0]
    # The reference's decimation, and its edges: what lies beyond the record is zero.
    angle, torque, velocity = (decimate(each[9:], 10) for each in (angle, torque, velocity))
    limits = tuple(parallel_reference[f"{name}polyRange"])
    inputs = chebyshev_of(np.pad(velocity, (lags, 0))[:-lags], limits, 12)
    piece = subspace.Piece(torque - torque.mean(), np.pad(angle - angle.mean(), lags), inputs)
    found = subspace.dynamics([piece], 20, 2)
    response = subspace.project(subspace.rows_of([piece], found)).response
    rest = piece.without(response)
    poles = subspace.dynamics([rest], 20, 2, lagged=False)
    reflex = subspace.hammerstein(subspace.rows_of([rest], poles), poles)
    assert response.sum() == pytest.approx(parallel_reference[f"{name}irf"].sum() / 100, rel=0.005)
    whole = 100 * (1 - np.var(reflex.left) / np.var(piece.output))
    assert whole == pytest.approx(parallel_reference[f"{name}vaf"][0], abs=0.3)

    # Where the velocities are. The reference ends its alternation early.
    weights = reflex.weights, parallel_reference[f"{name}polyCoef"]
    ours, theirs = (chebval(np.linspace(-1.2, 1.2, 49) / max(limits), each) for each in weights)
    a, b, c, d = (parallel_reference[f"{name}{part}"] for part in "ABCD")
    gain = d + c @ np.linalg.solve(np.eye(2) - a, b)
    assert reflex.static_gain * np.ptp(ours) == pytest.approx(gain * np.ptp(theirs), rel=0.05)
    np.testing.assert_allclose(np.roots(reflex.denominator), np.linalg.eigvals(a), atol=0.005)


@pytest.mark.parametrize(
    ("perturbation", "error", "least"),
    [("noise", 0.05, 98), pytest.param("prbs", 0.25, 95, marks=pytest.mark.slow)],
)
def test_a_constant_joint_with_a_reflex(perturbation, error, least):
    ensemble = constant(perturbation=perturbation)
    model = tv.SubspaceCascade().identify(ensemble)
    assert np.ptp(model.stiffness) == 0
    assert model.stiffness[0] == pytest.approx(100, abs=2)
    assert model.viscosity[0] == pytest.approx(2.2, rel=0.05)
    assert model.inertia[0] == pytest.approx(0.02, rel=0.06)  # lags of 40 ms are few for a PRBS
    assert model.estimates["reflex_gain"].values[0] == pytest.approx(8, rel=error)
    for name, torque in model.pathways(ensemble).items():
        known, true = np.isfinite(torque), ensemble.channels[name][:, ensemble.core]
        left = np.sum((true - torque)[known] ** 2) / np.sum(true[known] ** 2)
        assert 100 * (1 - left) > least


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"horizon": 1.0}, "horizon of 1 s has 100 samples at 100 Hz"),
        ({"order": 20}, "expected more than the 20 of the order"),
        ({"terms": 100}, r"41.8 s of record beyond the first 0.4 s .*, got 19.6 s"),
    ],
)
def test_what_it_cannot_serve_is_said(settings, reason):
    with pytest.raises(tv.InputError, match=f"SubspaceCascade: .*{reason}"):
        tv.SubspaceCascade(**settings).identify(constant(20.0))
