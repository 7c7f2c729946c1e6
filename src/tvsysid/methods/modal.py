"""Modal decomposition: stiffness from frequency and decay of a joint's ringing after impulses."""

from __future__ import annotations

import math
from itertools import pairwise

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from tvsysid.methods import base, shared
from tvsysid.models import Diagnostics, Model
from tvsysid.numerics.bases import FourierSeries, evaluate
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import optional, positive

LEAST = 0.25  # share of the largest torque from which on a peak counts as an impulse
ABOUT = 0.06  # s about its peak in which an impulse acts
IMPULSIVE, BUSY = 0.85, 0.3  # impulses hold at least this share of power in at most this of time
MOST_DAMPED = 0.35  # damping ratio up to which a joint rings for long enough
CLEAR, LASTING_S = 3.5, 0.25  # standard deviations; duration searched after an impulse
# standard deviation of the Gaussian by which angle and torque are smoothed to find the inertia
SMOOTH_S = 0.03
REACH = 4.0  # standard deviations to which the window extends
BAND = (1.0, 20.0)  # Hz in which the ridge is looked for
ROUNDS = 3  # in which the frequency is found
HARMONICS = 3  # with which stiffness and viscosity change where the inertia is fitted
# impulses from which on their spread tells the error, and samples after one that are looked at
FEWEST = 3


@attrs.frozen
class ModalDecomposition(base.Method):
    r"""Estimate the stiffness of a lightly damped joint from its ringing after impulses.

    Frequency and decay of the ringing give

    .. math:: k = I\,(\omega^2 + s^2 + \dot s), \qquad b = 2 I s, \qquad
              s = -\frac{d \ln A}{dt} - \frac{1}{2}\frac{d \ln \omega}{dt}

    with the frequency ω (rad/s) and the amplitude A of the wave that is fitted within a Gaussian
    window about each time, beside its mirror image at -ω and a constant. Each impulse gives 0.25 s,
    from 3.5 ``window`` after it on, as far as no other impulse is near. Each time has the mean over
    the impulses that reach it; the bands are those of their spread, where three or more do, and of
    the inertia.

    Parameters
    ----------
    inertia
        I of all that moves, in kg·m²; by default that of a least-squares fit to angle and torque.
    window
        Standard deviation of the Gaussian window in s.

    Notes
    -----
    The method suits a joint that moves freely, or with its load, between impulses of torque. It
    suits hardly any other joint: the ankle is damped too much (damping ratio 0.6 to 1.1).
    docs/special-perturbations.md has figures. The angle is the recorded one. Its mean over
    realizations is kept, because it consists of the ringing of all realizations.

    References
    ----------
    Piovesan, Pierobon, DiZio & Lackner 2012, J. Neurosci. Methods 209, 70-83.
    """

    inertia: float | None = attrs.field(default=None, validator=optional(positive))
    window: float = attrs.field(default=0.05, validator=positive)

    key = "modal"
    title = "Modal decomposition"
    assumptions = (
        "The joint is of second order, lightly damped, and free between impulses of torque.",
        "Nothing else moves it; its impedance hardly changes within a window.",
        "Behaviour is the same in all realizations.",
    )
    differs = (
        "It is read from how the joint rings after each impulse, and means nothing where that "
        "dies away within a cycle."
    )
    cites = ("piovesan2012",)
    uses_recorded_angle = True
    perturbation = "pulses:duration=0.02,interval=1"
    system = (
        "loaded:inertia=0.1,viscosity=1.3,"
        "actuator_stiffness=0,actuator_viscosity=0,actuator_inertia=0"
    )

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return a reason to skip if there are no torque impulses, or too much damping."""
        torque = ensemble.torque[:, ensemble.core]
        near = np.concatenate(
            [_impulses(torque[run].ravel(), ensemble.sampling_rate)[1] for run in ensemble.runs]
        )
        ordered = np.concatenate([torque[run].ravel() for run in ensemble.runs])
        share, busy = float(np.sum(ordered[near] ** 2) / np.sum(ordered**2)), float(near.mean())
        if share < IMPULSIVE or busy > BUSY:
            return (
                "the torque is no impulses with rests between them: its peaks take "
                f"{100 * busy:.0f} % of the time (at "
                f"most {100 * BUSY:g} %) and {100 * share:.0f} % of the power (at least "
                f"{100 * IMPULSIVE:g} %); it "
                "serves a joint that rings freely after impulses of torque"
            )
        stiffness, viscosity, inertia, _ = self._mean_impedance(ensemble)
        damping = (
            viscosity / (2 * math.sqrt(stiffness * inertia))
            if stiffness > 0 < inertia
            else math.nan
        )
        if not damping <= MOST_DAMPED:
            return (
                f"the joint does not ring: its damping ratio is {damping:.2g} ({stiffness:.3g} "
                "N·m/rad, "
                f"{viscosity:.3g} N·m·s/rad, {inertia:.3g} kg·m²), and {MOST_DAMPED:g} or less is "
                "needed"
            )
        return None

    def _mean_impedance(self, ensemble: Ensemble) -> tuple[float, float, float, float]:
        """Return mean stiffness, viscosity and inertia, and the relative error of inertia.

        They are fitted by least squares. Angle and torque are smoothed alike, which removes noise
        and the impulses' edges. Stiffness and viscosity have a few harmonics. The error takes
        realizations as independent samples.
        """
        rate, features = (
            ensemble.sampling_rate,
            evaluate(FourierSeries(HARMONICS), ensemble.samples),
        )
        lags = (
            np.arange(-math.ceil(REACH * SMOOTH_S * rate), math.ceil(REACH * SMOOTH_S * rate) + 1)
            / rate
        )
        smooth = np.exp(-((lags / SMOOTH_S) ** 2) / 2)
        slopes = (
            smooth,
            -lags / SMOOTH_S**2 * smooth,
            (lags**2 / SMOOTH_S**4 - 1 / SMOOTH_S**2) * smooth,
        )
        angle, velocity, acceleration = (
            scipy.signal.oaconvolve(ensemble.angle, each[None], "valid", axes=1) for each in slopes
        )
        torque = scipy.signal.oaconvolve(ensemble.torque, smooth[None], "valid", axes=1)
        place = np.arange(torque.shape[1]) + len(lags) // 2 - ensemble.context
        features = features[place % ensemble.samples]
        columns = [each[..., None] * features for each in (angle, velocity)]
        rows = np.concatenate([*columns, acceleration[..., None]], axis=2)
        inverse = np.linalg.inv(np.einsum("rta,rtb->ab", rows, rows))
        found = inverse @ np.einsum("rta,rt->a", rows, torque)
        scores = np.einsum("rta,rt->ra", rows, torque - rows @ found) @ inverse[-1]
        off = math.sqrt(float(np.sum(scores**2))) / abs(found[-1])
        return float(found[0]), float(found[features.shape[1]]), float(found[-1]), off

    def fit(self, ensemble: Ensemble) -> ModalModel:
        """Return the model of an ensemble."""
        rate, samples = ensemble.sampling_rate, ensemble.samples
        _, viscosity, inertia, off = self._mean_impedance(ensemble)
        decay = viscosity / (2 * inertia)
        inertia, off = (inertia, off) if self.inertia is None else (self.inertia, 0.0)
        clear, reach = math.ceil(CLEAR * self.window * rate), round(REACH * self.window * rate)
        tracks: list[tuple[NDArray[np.int64], Array]] = []
        for run in ensemble.runs:
            own = ensemble.select(run)
            recorded = own.angle_as_recorded[:, own.core]
            angle = recorded.reshape(len(own) * samples, -1).mean(axis=1)
            peaks = _impulses(own.torque[:, own.core].ravel(), rate)[0]
            for peak, following in pairwise([*peaks, len(angle) - reach + clear]):
                last = min(
                    peak + clear + round(LASTING_S * rate),
                    following - clear,
                    len(angle) - reach - 1,
                )
                times = np.arange(max(peak + clear, reach), last + 1)
                if len(times) >= FEWEST:
                    found = track(angle, times, self.window, rate, inertia, decay)
                    tracks.append((times % samples, found))
        mean, error, count = _over_impulses(tracks, samples)
        error = np.hypot(error, off * mean)
        freedom = np.maximum(count - 1.0, 1.0)
        errors = {
            name: shared.StandardError(values, freedom)
            for name, values in zip(
                shared.IMPEDANCE, (*error.T, np.full(samples, np.nan)), strict=True
            )
        }
        constant = np.where(np.isnan(mean[:, 0]), np.nan, inertia)
        return ModalModel(
            method=repr(self),
            sampling_rate=rate,
            time=ensemble.time,
            estimates=shared.impedance_estimates(mean[:, 0], mean[:, 1], constant, errors),
            diagnostics=Diagnostics(2.0, details={"impulses": float(len(tracks))}),
        )


@attrs.frozen(eq=False, repr=False, kw_only=True)
class ModalModel(Model):
    """Stiffness and viscosity at the times after impulses, and a known inertia."""


def _impulses(torque: Array, rate: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the samples at which impulses of a torque (time,) peak, and which samples lie near."""
    size = np.abs(torque)
    places, _ = scipy.signal.find_peaks(
        size, height=LEAST * size.max(initial=0.0), distance=max(1, round(2 * ABOUT * rate))
    )
    near = np.zeros(len(torque), dtype=bool)
    for offset in range(-round(ABOUT * rate), round(ABOUT * rate) + 1):
        near[np.clip(places + offset, 0, len(torque) - 1)] = True
    return places.astype(np.int64), near


def track(
    angle: Array, times: NDArray[np.int64], width: float, rate: float, inertia: float, decay: float
) -> Array:
    """Return stiffness and viscosity (time, 2) at consecutive samples of an angle that rings.

    In a window about each time, the fit has a wave with a ``decay`` in 1/s, its mirror image at
    the negative frequency, and a constant. The wave's phase and size over time give frequency and
    decay.
    """
    reach = round(REACH * width * rate)
    lags = np.arange(-reach, reach + 1) / rate
    window = np.exp(-((lags / width) ** 2) / 2)
    segments = angle[times[:, None] + np.arange(-reach, reach + 1)]
    grid = 2 * np.pi * np.arange(BAND[0], min(BAND[1], rate / 2), 0.5)
    speed = grid[
        np.argmax(np.abs((segments * window) @ np.exp(-1j * np.outer(lags, grid))), axis=1)
    ]
    for _ in range(ROUNDS):
        wave = np.exp(np.multiply.outer(1j * speed - decay, lags))
        columns = np.stack([wave, wave.conj(), np.ones(wave.shape)], axis=1)
        # Equal weights before and after the time
        weighted = columns.conj() * window * np.exp(2 * decay * lags)
        gram, cross = weighted @ columns.transpose(0, 2, 1), weighted @ segments[..., None]
        size = np.linalg.solve(gram, cross)[:, 0, 0]
        found = np.gradient(np.unwrap(np.angle(size)), 1 / rate)
        speed = np.full(len(times), np.clip(np.median(found), grid[0], grid[-1]))
    fade = -np.gradient(np.log(np.abs(size)), 1 / rate) - 0.5 * np.gradient(
        np.log(np.maximum(found, grid[0])), 1 / rate
    )
    stiffness = found**2 + fade**2 + np.gradient(fade, 1 / rate)
    return inertia * np.stack([stiffness, 2 * fade], axis=1)


def _over_impulses(
    tracks: list[tuple[NDArray[np.int64], Array]], samples: int
) -> tuple[Array, Array, Array]:
    """Return the mean (time, 2) over impulses, its standard error, and their number, over time."""
    values = np.full((max(len(tracks), 1), samples, 2), np.nan)
    for row, (times, track) in zip(values, tracks, strict=False):
        row[times] = track
    count = np.isfinite(values[..., 0]).sum(axis=0)
    known = np.where(count, count, np.nan)[:, None]
    mean = np.nansum(values, axis=0) / known
    square = np.nansum((values - mean) ** 2, axis=0) / np.maximum(known - 1, 1)
    return mean, np.where(count[:, None] >= FEWEST, np.sqrt(square / known), np.nan), count
