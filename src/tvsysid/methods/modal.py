"""Modal decomposition: stiffness from how fast a joint rings after an impulse, and how soon that dies away."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from tvsysid.methods import base, shared
from tvsysid.models import Diagnostics, Model
from tvsysid.numerics.bases import FourierSeries, evaluate
from tvsysid.signals import Array, Ensemble

LEAST = 0.25  # share of the largest torque from which on a peak counts as an impulse
ABOUT = 0.06  # s about its peak in which an impulse acts
IMPULSIVE, BUSY = 0.85, 0.3  # shares of the torque's power and of the time that impulses take, at least and at most
MOST_DAMPED = 0.35  # damping ratio up to which a joint rings for long enough
FROM, UNTIL = 0.1, 0.4  # s after an impulse that are looked at
REACH = 4.0  # standard deviations to which the window extends
BAND = (1.0, 20.0)  # Hz in which the ridge is looked for
HARMONICS = 3  # with which stiffness and viscosity change where the inertia is fitted
FEWEST = 3  # impulses from which on their spread tells the error


@dataclass(frozen=True)
class ModalDecomposition(base.Method):
    r"""Stiffness of a lightly damped joint from the frequency and the decay with which it rings after impulses.

    .. math:: k = I\,(\omega^2 + s^2 + \dot s), \qquad b = 2 I s, \qquad
              s = -\frac{d \ln A}{dt} - \frac{1}{2}\frac{d \ln \omega}{dt}

    with the frequency ω (rad/s) and the amplitude A along the ridge of a spectrogram with a Gaussian window, whose
    frequency is reassigned. Each impulse gives the time from 0.1 to 0.4 s after it, and each time the mean over the
    impulses that reach it; the bands are those of their spread, where three or more do.

    Parameters
    ----------
    inertia
        I of all that moves, in kg·m²; by default that of a least-squares fit to angle and torque.
    window
        Standard deviation of the Gaussian window in s.

    Notes
    -----
    It serves a joint that moves freely, or with its load, between impulses of torque, and hardly anybody else: the
    ankle is damped too much (damping ratio 0.6 to 1.1). A longer window lowers the random error of one impulse, but
    biases stiffness, by -2 % at 0.08 s and a damping ratio of 0.2; docs/special-perturbations.md has figures. The angle
    is the one that was recorded, with the mean over realizations, for that is made of the ringing of all.

    References
    ----------
    Piovesan, Pierobon, DiZio & Lackner 2012, J. Neurosci. Methods 209, 70-83; the reassigned frequency: Auger &
    Flandrin 1995, IEEE Trans. Signal Process. 43, 1068-1089.
    """

    inertia: float | None = None
    window: float = 0.05

    key: ClassVar[str] = "modal"
    title: ClassVar[str] = "Modal decomposition"
    assumptions: ClassVar[tuple[str, ...]] = (
        "The joint is of second order, lightly damped, and free between impulses of torque.",
        "Nothing else moves it; its impedance hardly changes within a window.",
        "Behaviour is the same in all realizations.",
    )
    differs: ClassVar[str] = (
        "It is read from how the joint rings after each impulse, and means nothing where that dies away within a cycle."
    )
    cites: ClassVar[tuple[str, ...]] = ("piovesan2012",)
    uses_recorded_angle: ClassVar[bool] = True
    perturbation: ClassVar[str] = "pulses:duration=0.02,interval=1"
    system: ClassVar[str] = (
        "loaded:inertia=0.1,viscosity=1.3,actuator_stiffness=0,actuator_viscosity=0,actuator_inertia=0"
    )

    def __post_init__(self) -> None:
        base.check_positive(self, window=self.window)
        if self.inertia is not None:
            base.check_positive(self, inertia=self.inertia)

    def skip(self, ensemble: Ensemble) -> str | None:
        """Where the torque is no impulses, or the joint is damped too much."""
        torque = ensemble.torque[:, ensemble.core]
        near = np.concatenate([_impulses(torque[run].ravel(), ensemble.sampling_rate)[1] for run in ensemble.runs])
        ordered = np.concatenate([torque[run].ravel() for run in ensemble.runs])
        share, busy = float(np.sum(ordered[near] ** 2) / np.sum(ordered**2)), float(near.mean())
        if share < IMPULSIVE or busy > BUSY:
            return (
                f"the torque is no impulses with rests between them: its peaks take {100 * busy:.0f} % of the time (at "
                f"most {100 * BUSY:g} %) and {100 * share:.0f} % of the power (at least {100 * IMPULSIVE:g} %); it "
                "serves a joint that rings freely after impulses of torque"
            )
        stiffness, viscosity, inertia = self._mean_impedance(ensemble)
        damping = viscosity / (2 * math.sqrt(stiffness * inertia)) if stiffness > 0 < inertia else math.nan
        if not damping <= MOST_DAMPED:
            return (
                f"the joint does not ring: its damping ratio is {damping:.2g} ({stiffness:.3g} N·m/rad, "
                f"{viscosity:.3g} N·m·s/rad, {inertia:.3g} kg·m²), and {MOST_DAMPED:g} or less is needed"
            )
        return None

    def _mean_impedance(self, ensemble: Ensemble) -> tuple[float, float, float]:
        """Mean stiffness, viscosity and inertia by least squares, with a few harmonics of the first two."""
        features = evaluate(FourierSeries(HARMONICS), ensemble.samples)
        angle, velocity, acceleration = ensemble.derivatives()
        known = np.isfinite(acceleration[0])
        changing = [(each[..., None] * features)[:, known] for each in (angle, velocity)]
        columns = np.concatenate([*changing, acceleration[:, known, None]], axis=2).reshape(
            -1, 2 * features.shape[1] + 1
        )
        found = np.linalg.lstsq(columns, ensemble.torque[:, ensemble.core][:, known].ravel(), rcond=None)[0]
        inertia = found[-1] if self.inertia is None else self.inertia
        return float(found[0]), float(found[features.shape[1]]), float(inertia)

    def _identify(self, ensemble: Ensemble) -> ModalModel:
        rate, samples = ensemble.sampling_rate, ensemble.samples
        inertia = self._mean_impedance(ensemble)[2]
        tracks: list[tuple[NDArray[np.int64], Array]] = []
        for run in ensemble.runs:
            own = ensemble.select(run)
            recorded = own.angle_as_recorded[:, own.core]
            angle = recorded.reshape(len(own) * samples, -1).mean(axis=1)
            for peak in _impulses(own.torque[:, own.core].ravel(), rate)[0]:
                times = peak + np.arange(math.ceil(FROM * rate), math.floor(UNTIL * rate) + 1)
                if times[-1] + round(REACH * self.window * rate) < len(angle):
                    tracks.append((times % samples, track(angle, times, self.window, rate, inertia)))
        mean, error, count = _over_impulses(tracks, samples)
        freedom = np.maximum(count - 1.0, 1.0)
        errors = {
            name: shared.StandardError(values, freedom)
            for name, values in zip(shared.IMPEDANCE, (*error.T, np.full(samples, np.nan)), strict=True)
        }
        constant = np.where(np.isnan(mean[:, 0]), np.nan, inertia)
        return ModalModel(
            method=repr(self),
            sampling_rate=rate,
            time=ensemble.time,
            estimates=shared.impedance_estimates(mean[:, 0], mean[:, 1], constant, errors),
            diagnostics=Diagnostics(2.0, details={"impulses": float(len(tracks))}),
        )

    def _needed_band(self) -> tuple[float, float]:
        return math.inf, 0.0


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ModalModel(Model):
    """Stiffness and viscosity where impulses tell them, and an inertia that is known."""

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        each = (self.stiffness, self.viscosity, self.inertia)
        return {"intrinsic": np.asarray(sum(map(np.multiply, each, ensemble.derivatives())))}


def _impulses(torque: Array, rate: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Samples at which impulses of a torque (time,) peak, and whether each sample is within one."""
    size = np.abs(torque)
    places, _ = scipy.signal.find_peaks(
        size, height=LEAST * size.max(initial=0.0), distance=max(1, round(2 * ABOUT * rate))
    )
    near = np.zeros(len(torque), dtype=bool)
    for offset in range(-round(ABOUT * rate), round(ABOUT * rate) + 1):
        near[np.clip(places + offset, 0, len(torque) - 1)] = True
    return places.astype(np.int64), near


def track(angle: Array, times: NDArray[np.int64], width: float, rate: float, inertia: float) -> Array:
    """Stiffness and viscosity at these samples of an angle, shape (time, 2), from the ridge of its spectrogram."""
    reach = round(REACH * width * rate)
    lags = np.arange(-reach, reach + 1) / rate
    window = np.exp(-((lags / width) ** 2) / 2)
    segments = angle[times[:, None] + np.arange(-reach, reach + 1)] * window
    grid = 2 * np.pi * np.arange(BAND[0], min(BAND[1], rate / 2), 0.5)
    speed = grid[np.argmax(np.abs(segments @ np.exp(-1j * np.outer(lags, grid))), axis=1)]
    for _ in range(4):  # the reassigned frequency, until it is the one that it is looked at
        turned = segments * np.exp(-1j * np.outer(speed, lags))
        spectrum = turned.sum(axis=1)
        speed = np.maximum(speed + ((turned @ (lags / width**2)) / spectrum).imag, grid[0])
    amplitude = np.log(np.abs((segments * np.exp(-1j * np.outer(speed, lags))).sum(axis=1)))
    decay = -np.gradient(amplitude, 1 / rate) - 0.5 * np.gradient(np.log(speed), 1 / rate)
    stiffness = speed**2 + decay**2 + np.gradient(decay, 1 / rate)
    return inertia * np.stack([stiffness, 2 * decay], axis=1)


def _over_impulses(tracks: list[tuple[NDArray[np.int64], Array]], samples: int) -> tuple[Array, Array, Array]:
    """Mean over impulses (time, 2), its standard error, and how many there are at each time."""
    values = np.full((max(len(tracks), 1), samples, 2), np.nan)
    for row, (times, track) in zip(values, tracks, strict=False):
        row[times] = track
    count = np.isfinite(values[..., 0]).sum(axis=0)
    known = np.maximum(count, 1)[:, None]
    mean = np.where(count[:, None], np.nansum(values, axis=0) / known, np.nan)
    square = np.nansum((values - mean) ** 2, axis=0) / np.maximum(known - 1, 1)
    return mean, np.where(count[:, None] >= FEWEST, np.sqrt(square / known), np.nan), count
