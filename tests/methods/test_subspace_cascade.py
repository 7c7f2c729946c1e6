"""Structural decomposition by subspaces: simulated joints, real ones, and the authors' own code."""

import warnings

import attrs
import numpy as np
import pytest
from numpy.polynomial.chebyshev import chebval
from scipy.io import loadmat
from scipy.signal import decimate

import tvsysid as tv
from tvsysid.numerics import subspace
from tvsysid.numerics.bases import chebyshev_of
from tvsysid.numerics.stretch import recorded_velocity


@pytest.fixture(autouse=True)
def _warnings_are_not_the_point():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tv.DataQualityWarning)
        yield


def simulated(duration=60.0, stiffness=100.0, gain=8.0, perturbation="noise", snr_db=20.0, seed=1):
    """Ensemble, mean subtracted, with each pathway's torque as a channel, and the truth."""
    joint = tv.simulate.ReflexJoint(
        stiffness=stiffness if callable(stiffness) else tv.simulate.Constant(stiffness),
        reflex_gain=gain,
    )
    found = joint.simulate(
        duration, perturbation=tv.simulate.PERTURBATIONS[perturbation], snr_db=snr_db, seed=seed
    )
    recording = attrs.evolve(found.recording, channels=found.pathways)
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    return tv.preprocess.subtract_mean(
        ensemble, ("intrinsic", "reflex") if gain else ()
    ), found.truth_of(ensemble)


def share(torque, part):
    known = np.isfinite(part)
    return 100 * (1 - np.sum((torque - part)[known] ** 2) / np.sum(torque[known] ** 2))


def fitted(piece, order):
    """Fit the intrinsic response and the Hammerstein system to a whole record.

    As in the authors' first paper.
    """
    found = subspace.dynamics([piece], 20, order)
    response = subspace.project(subspace.rows_of(piece, found)).response
    rest = piece._replace(output=piece.output - piece.regressors() @ response)
    poles = subspace.dynamics([rest], 20, order, lagged=False)
    rows = subspace.rows_of(rest, poles)
    return response, subspace.hammerstein(rows, poles, subspace.weights_of(rows, order))


@pytest.mark.parametrize(
    "muscle",
    [
        "plantarflexor",
        *(pytest.param(each, marks=pytest.mark.slow) for each in ("dorsiflexor", "dorsiflexor_2")),
    ],
)
def test_it_agrees_with_the_authors_code(recordings_folder, parallel_reference, muscle):
    lags, name = 4, f"{muscle}__sdss_rank_revealing_40ms_"
    recorded = loadmat(recordings_folder / "tonic_ankle.mat")
    angle, torque = (recorded[f"{muscle}_{signal}"][:, 0] for signal in ("angle", "torque"))
    velocity = recorded_velocity(angle[None, :, None], 1000.0)[0]
    # The reference's decimation, and its edges: what lies beyond the record is zero.
    angle, torque, velocity = (decimate(each[9:], 10) for each in (angle, torque, velocity))
    limits = tuple(parallel_reference[f"{name}polyRange"])
    np.testing.assert_allclose((velocity.min(), velocity.max()), limits, rtol=1e-3)
    late = np.concatenate([np.zeros(lags), velocity[:-lags]])
    piece = subspace.Piece(
        torque - torque.mean(), np.pad(angle - angle.mean(), lags), chebyshev_of(late, limits, 12)
    )
    response, reflex = fitted(piece, 2)
    assert response.sum() == pytest.approx(parallel_reference[f"{name}irf"].sum() / 100, rel=0.005)
    whole = 100 * (1 - np.var(reflex.left) / np.var(piece.output))
    assert whole == pytest.approx(parallel_reference[f"{name}vaf"][0], abs=0.3)

    # Where the velocities are. The reference ends its alternation early.
    range_ = np.linspace(-1.2, 1.2, 49) / max(limits)
    ours, theirs = (
        chebval(range_, reflex.weights),
        chebval(range_, parallel_reference[f"{name}polyCoef"]),
    )
    assert np.corrcoef(ours, theirs)[0, 1] > 0.99
    a, b, c, d = (parallel_reference[f"{name}{part}"] for part in "ABCD")
    gain = d + c @ np.linalg.solve(np.eye(2) - a, b)
    assert reflex.static_gain * np.ptp(ours) == pytest.approx(gain * np.ptp(theirs), rel=0.05)
    np.testing.assert_allclose(np.roots(reflex.denominator), np.linalg.eigvals(a), atol=0.005)


@pytest.mark.parametrize(
    ("muscle", "stiffness", "explained"),
    [("dorsiflexor", 71.6, 94), pytest.param("dorsiflexor_2", 53.2, 94, marks=pytest.mark.slow)],
)
def test_real_ankles(recordings_folder, muscle, stiffness, explained):
    file = recordings_folder / "tonic_ankle.mat"
    signals = {"angle": f"{muscle}_angle", "torque": f"{muscle}_torque"}
    recording = tv.read_recording(file, **signals, sampling_rate=1000, torque_sign=-1)
    ensemble = tv.preprocess.subtract_mean(
        tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    )
    model = tv.SubspaceCascade().identify(ensemble)
    assert model.stiffness[0] == pytest.approx(stiffness, rel=0.03)
    assert share(ensemble.torque[:, ensemble.core], model.predict(ensemble)) == pytest.approx(
        explained, abs=1
    )


@pytest.mark.parametrize("perturbation", ["noise", pytest.param("prbs", marks=pytest.mark.slow)])
def test_a_constant_joint_with_a_reflex(perturbation):
    ensemble, _ = simulated(perturbation=perturbation)
    model = tv.SubspaceCascade().identify(ensemble)
    assert np.ptp(model.stiffness) == 0
    assert model.stiffness[0] == pytest.approx(100, abs=2)
    assert model.viscosity[0] == pytest.approx(2.2, rel=0.05)
    assert model.inertia[0] == pytest.approx(0.02, rel=0.06)  # lags of 40 ms are few for a PRBS
    assert model.estimates["reflex_gain"].values[0] == pytest.approx(
        8, rel=0.25 if perturbation == "prbs" else 0.05
    )
    for name, torque in model.pathways(ensemble).items():
        assert share(ensemble.channels[name][:, ensemble.core], torque) > (
            98 if perturbation == "noise" else 95
        )


@pytest.mark.slow
def test_without_a_reflex_none_is_found():
    ensemble, _ = simulated(gain=0.0)
    model = tv.SubspaceCascade().identify(ensemble)
    assert model.stiffness[0] == pytest.approx(100, abs=2)
    assert abs(model.estimates["reflex_gain"].values[0]) < 0.3


@pytest.mark.slow
def test_stiffness_and_gain_that_change_are_followed_in_a_window():
    sine = tv.simulate.SineWave
    ensemble, truth = simulated(150.0, sine(), sine(8, 4), snr_db=10)
    model = tv.SubspaceCascade(window=0.3, terms=4).identify(ensemble)
    for name, mean, rms in (("stiffness", 3.0, 6.0), ("reflex_gain", 0.5, 1.5)):
        error = model.over_time(name) - truth[name].mean(axis=0)
        assert abs(error.mean()) < mean
        assert np.sqrt(np.mean(error**2)) < rms
    # A method of one pathway takes the reflex for stiffness.
    assert np.mean(tv.ShortDataSegments().identify(ensemble).stiffness - truth["stiffness"]) > 15
    assert share(ensemble.torque[:, ensemble.core], model.predict(ensemble)) > 90


@pytest.mark.slow
def test_segments_that_do_not_follow_each_other_are_pooled():
    ensemble, _ = simulated()
    apart = attrs.evolve(ensemble, onsets=None, trials=None)
    together, pooled = (tv.SubspaceCascade().identify(each) for each in (ensemble, apart))
    assert len(apart.runs) == len(apart)
    assert pooled.stiffness[0] == pytest.approx(together.stiffness[0], abs=1)
    error = [each.estimates["stiffness"].standard_error.values[0] for each in (together, pooled)]
    assert 0.9 * error[0] < error[1] < 1.3 * error[0]


@pytest.mark.parametrize(
    ("method", "reason"),
    [
        (tv.SubspaceCascade(horizon=1.0), "horizon of 1 s has 100 samples at 100 Hz"),
        (tv.SubspaceCascade(order=20), "expected more than the 20 of the order"),
        (
            tv.SubspaceCascade(terms=100),
            "with 41.8 s together beyond that; got 1 of up to 20 s, with 19.6 s",
        ),
    ],
)
def test_what_it_cannot_serve_is_said(method, reason):
    ensemble, _ = simulated(20.0)
    assert reason in method.skip(ensemble)
    with pytest.raises(tv.InputError, match="SubspaceCascade: "):
        method.identify(ensemble)


def test_a_window_of_too_few_samples_is_refused():
    ensemble, _ = simulated(20.0)
    with pytest.raises(tv.InputError, match=r"window of 0.03 s holds 30 samples .* it needs 66"):
        tv.SubspaceCascade(window=0.03).identify(ensemble)
