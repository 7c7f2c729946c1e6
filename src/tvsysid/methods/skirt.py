"""Skirt decomposition: how the response to each line of a multisine changes in time."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.special import chdtrc, gammaincc

from tvsysid.methods import base, shared
from tvsysid.methods.responses import SecondOrderModel
from tvsysid.models import Diagnostics
from tvsysid.numerics.bases import FourierSeries, evaluate
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import Validator, at_least, optional, positive

ComplexArray = NDArray[np.complex128]

MOST = 20  # lines that are looked for
LINES = 0.99  # share of the angle's variance that lines must explain
WEAK = 1e-4  # share of it from which on a peak counts as a line
BEYOND = 4  # harmonics beyond those that lines leave room for, whose skirts are looked for
LIKELY, SURE = 0.05, 1e-4  # p-values below which a skirt is fitted, and warned of
NOISELESS = 1e-5  # share of the torque's variance below which what is left is rounding and filters
# of 1/period about its multiples, where a mean over realizations that was subtracted leaves lines
ON_GRID = 0.02
NEAR = 2.0  # Hz about a line within which the residual tells its noise
DISAGREEMENT = "lines that do not agree with each other"


FREQUENCIES = Validator("positive numbers", lambda several: all(map(positive.is_valid, several)))


@attrs.frozen
class SkirtDecomposition(base.Method):
    r"""Identify the response to each line of a multisine. Its change widens the line into a skirt.

    .. math:: y(t) = \sum_k \mathrm{Re}\{G_k(t)\, U_k\, e^{j\omega_k t}\}, \qquad
              G_k(t) = \sum_{h=-H}^{H} g_{kh}\, e^{2\pi j h t / p}
              = k(t) + j\omega_k\, b(t) - I\,\omega_k^2

    The g of all lines are fitted together by least squares, and stiffness, viscosity and inertia to
    them, weighted by their covariance. What a line U is comes from the angle itself, so that
    filters that angle and torque pass alike do not matter.

    Parameters
    ----------
    frequencies
        Lines in Hz; by default they are looked for in the angle.
    harmonics
        H of the period p, the duration of a realization, of which the impedance's change is a sum.
        Skirts may not overlap: lines must be more than 2 H / p apart. If None, up to the highest
        harmonic whose skirts the torque shows; ``harmonics`` among the diagnostics' details is the
        number chosen. A warning says where skirts are left.

    Notes
    -----
    The imposed angle must be a multisine and nothing else (to 1 % of its variance), with one or
    more frequencies for each of stiffness and inertia. The lines' phases are those of each trial.
    With its few unknowns, the method is better than ``kbr`` for a slow change of known smoothness,
    and worse for any other change. docs/special-perturbations.md has figures.

    The bands count the residual's power within 2 Hz of each line.

    References
    ----------
    Lataire, Pintelon & Louarroudi 2012, Automatica 48, 783-791.
    """

    frequencies: tuple[float, ...] | None = attrs.field(
        default=None, validator=optional(FREQUENCIES)
    )
    harmonics: int | None = attrs.field(default=None, validator=optional(at_least(0)))

    key = "skirt"
    title = "Skirt decomposition"
    assumptions = (
        "The angle is imposed, and a multisine whose lines are far apart.",
        "Impedance changes over a realization as a sum of a few harmonics, alike in all "
        "realizations.",
        "The joint is of second order, its inertia constant.",
    )
    differs = (
        "It changes as a few harmonics of the period can: what changes faster comes out slower."
    )
    cites = ("lataire2012",)
    perturbation = "multisine"

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return a reason to skip if the angle is no multisine, or its lines are unsuitable."""
        lines = self._lines(ensemble)
        found = ", ".join(f"{line:.4g}" for line in lines) or "none"
        share = 0.0
        if lines.size:
            waves, angle = self._waves(ensemble, lines)
            share = 1 - float(np.sum((angle - waves.real.sum(axis=0)) ** 2) / np.sum(angle**2))
        if share < LINES:
            return (
                f"the angle is no multisine: lines ({found} Hz) explain {100 * share:.1f} % of it, "
                f"and {100 * LINES:g} % are needed; perturb with some sines of fixed frequencies "
                "and impose the angle"
            )
        if lines.size < 2:
            return (
                f"one line ({found} Hz) cannot tell stiffness from inertia; two or more are needed"
            )
        if (self.harmonics or 0) > _most_harmonics(lines, ensemble):
            return (
                f"the skirts of lines {np.diff(np.sort(lines)).min():.3g} Hz apart overlap: a "
                f"change of {self.harmonics} harmonics of {1 / ensemble.duration:.3g} Hz needs "
                "lines twice as far apart or further; give fewer harmonics"
            )
        return None

    def fit(self, ensemble: Ensemble) -> SecondOrderModel:
        """Return the model of an ensemble."""
        lines = self._lines(ensemble)
        waves, _ = self._waves(ensemble, lines)
        most, chosen = _most_harmonics(lines, ensemble), self.harmonics or 0
        while True:
            features = evaluate(FourierSeries(chosen), ensemble.samples)
            skirts = _skirts(ensemble, waves, features, lines)
            p_values = {
                each: _p_value(each, chosen, lines, skirts, waves, ensemble)
                for each in range(chosen + 1, most + BEYOND + 1)
            }
            likely = [each for each, p in p_values.items() if each <= most and p < LIKELY]
            if self.harmonics is not None or not likely:
                break
            chosen = max(likely)
        posterior, agreement = _second_order(skirts, lines, features.shape[1])
        left = [str(each) for each, p in p_values.items() if p < SURE]
        share, warned = np.var(skirts.left) / np.var(ensemble.torque[:, ensemble.core]), ""
        if share > NOISELESS and (left or agreement < SURE):
            found = f"skirts of harmonic {', '.join(left)}" if left else DISAGREEMENT
            warned = (
                f"the torque has {found}, where the impedance that is fitted changes by {chosen} "
                "harmonics, which no band counts: it changes faster, or is not of second order; "
                "give more harmonics, or use kbr"
            )
        count = features.shape[1]
        expansions = (features, features, np.ones((ensemble.samples, 1)))
        ends = (slice(count), slice(count, 2 * count), slice(2 * count, None))
        errors = partial(
            shared.posterior_errors,
            expansions,
            [posterior.covariance[part, part] for part in ends],
            skirts.freedom,
            ensemble.samples,
        )
        parts = zip(expansions, ends, strict=True)
        impedance = np.stack([own @ posterior.mean[part] for own, part in parts], axis=1)
        names = [f"{name} {j}" for name in ("stiffness", "viscosity") for j in range(count)]
        return SecondOrderModel(
            method=repr(self),
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=shared.impedance_estimates(impedance, errors),
            posterior=posterior,
            labels=(*names, "inertia"),
            diagnostics=Diagnostics(
                posterior.effective,
                warnings=(warned,) if warned else (),
                details={"lines": float(len(lines)), "harmonics": float(chosen)},
            ),
        )

    def _lines(self, ensemble: Ensemble) -> Array:
        """Return the frequencies (line,) in Hz."""
        if self.frequencies is not None:
            return np.array(self.frequencies)
        run = max(ensemble.runs, key=len)
        lines = _found(ensemble.angle[run, ensemble.core].ravel(), ensemble.sampling_rate)
        beside = np.abs(lines * ensemble.duration - np.round(lines * ensemble.duration))
        # Subtracting the mean has removed what lies on the grid
        return lines[beside > ON_GRID] if ensemble.mean_subtracted else lines

    def _waves(self, ensemble: Ensemble, lines: Array) -> tuple[ComplexArray, Array]:
        """Return each line as a complex wave (line, realization, time), and the angle.

        The waves are fitted to the angle of each trial.
        """
        assert ensemble.onsets is not None
        assert ensemble.trials is not None
        angle = ensemble.angle[:, ensemble.core]
        turning = np.exp(
            2j * np.pi * lines[:, None, None] * (ensemble.onsets[:, None] + ensemble.time)
        )
        if (
            ensemble.mean_subtracted and np.ptp(ensemble.trials) == 0
        ):  # as angle and torque have lost theirs
            turning -= turning.mean(axis=1, keepdims=True)
        for trial in np.unique(ensemble.trials):
            own = ensemble.trials == trial
            part = turning[:, own].reshape(len(lines), -1)
            columns = np.concatenate([part.real, -part.imag, np.ones((1, part.shape[1]))])
            found = np.linalg.lstsq(columns.T, angle[own].ravel(), rcond=None)[0]
            angle = np.where(own[:, None], angle - found[-1], angle)
            turning[:, own] *= (found[: len(lines)] + 1j * found[len(lines) : -1])[:, None, None]
        return turning, angle


class Skirts(NamedTuple):
    """Coefficients g of the lines, their covariance, and its degrees of freedom.

    The coefficients (line, real or imaginary, function) are in a row. Their residual torque has
    shape (realization, time). Its ``density`` (line,) about each line is 1 for white noise.
    """

    mean: Array
    covariance: Array
    density: Array
    freedom: float
    left: Array


def _skirts(ensemble: Ensemble, waves: ComplexArray, features: Array, lines: Array) -> Skirts:
    """Fit all lines' responses to the torque."""
    torque = ensemble.torque[:, ensemble.core]
    torque = (torque - torque.mean()).ravel()
    parts = np.stack([waves.real, -waves.imag], axis=1)[:, :, None] * features.T[:, None]
    columns = parts.reshape(-1, torque.size)
    gram = columns @ columns.T
    inverse = np.linalg.inv(gram)
    mean = inverse @ (columns @ torque)
    left = (torque - mean @ columns).reshape(len(ensemble), -1)
    power = np.mean(np.abs(rfft(left, axis=1)) ** 2, axis=0) / left.shape[1]
    frequencies = np.fft.rfftfreq(left.shape[1], 1 / ensemble.sampling_rate)
    density, freedom = np.empty(len(lines)), np.empty(len(lines))
    for place, line in enumerate(lines):
        near = np.abs(frequencies - line) <= max(NEAR, 1.5 / ensemble.duration)
        numbers = 2.0 * near.sum() * shared.independent_realizations(ensemble)
        taken = 2 * features.shape[1] * np.sum(np.abs(lines - line) <= NEAR)
        freedom[place] = max(1.0, numbers - taken)
        density[place] = power[near].mean() * 2 * near.sum() * len(ensemble) / freedom[place]
    each = np.repeat(np.sqrt(density), 2 * features.shape[1])
    covariance = inverse @ (gram * np.outer(each, each)) @ inverse
    return Skirts(mean, covariance, density, float(freedom.min()), left)


def _most_harmonics(lines: Array, ensemble: Ensemble) -> int:
    """Return the number of harmonics up to which skirts do not overlap."""
    return math.ceil(float(np.diff(np.sort(lines)).min()) * ensemble.duration / 2 - ON_GRID) - 1


def _p_value(
    harmonic: int,
    chosen: int,
    lines: Array,
    skirts: Skirts,
    waves: ComplexArray,
    ensemble: Ensemble,
) -> float:
    """Return the probability that noise alone leaves such skirts of a harmonic of the period.

    Where these meet skirts of up to the harmonic ``chosen``, which are fitted, nothing is left
    to see.
    """
    sides = np.array([[1.0], [-1.0]])
    beside = np.abs(lines + sides * harmonic / ensemble.duration)
    seen = np.abs(beside[..., None] - lines).min(axis=2) > (chosen + 0.5) / ensemble.duration
    turning = np.exp(2j * np.pi * harmonic * sides * ensemble.time / ensemble.duration)
    parts = waves * turning[:, None, None]
    power = np.abs(np.einsum("skrt,rt->sk", parts.conj(), skirts.left)) ** 2
    ratio = power / (skirts.density * np.einsum("skrt,skrt->sk", parts, parts.conj()).real)
    return float(gammaincc(seen.sum(), ratio[seen].sum())) if seen.any() else 1.0


def _second_order(skirts: Skirts, lines: Array, count: int) -> tuple[shared.Regression, float]:
    """Fit functions of stiffness and viscosity, and the inertia, to the responses of all lines.

    Return also the probability that noise alone makes the lines differ as much from the fit.
    """
    speed = 2 * np.pi * lines
    design = np.zeros((len(lines), 2, count, 2 * count + 1))
    for function in range(count):
        design[:, 0, function, function] = 1.0
        design[:, 1, function, count + function] = speed
    design[:, 0, 0, -1] = -(speed**2)
    flat = design.reshape(-1, 2 * count + 1)
    weighted = np.linalg.solve(skirts.covariance, flat)
    covariance = np.linalg.inv(flat.T @ weighted)
    mean = covariance @ (weighted.T @ skirts.mean)
    posterior = shared.Regression(
        mean, covariance, float(skirts.density.mean()), float(len(mean)), math.nan, 1, True
    )
    rest = skirts.mean - flat @ mean
    misfit = float(rest @ np.linalg.solve(skirts.covariance, rest))
    return posterior, float(chdtrc(len(rest) - len(mean), misfit))


def _found(angle: Array, rate: float) -> Array:
    """Return the frequencies in Hz of the lines of a signal (time,), the strongest first.

    At each of them the phase does not turn.
    """
    samples = len(angle)
    half, left = samples // 2, angle - angle.mean()
    total, lines = float(np.sum(left**2)), np.empty(0)
    windows = np.zeros((2, samples))
    windows[0, :half] = windows[1, half : 2 * half] = np.hanning(half)
    time = np.arange(samples) / rate
    while len(lines) < MOST and total > 0:
        spectrum = np.abs(rfft(left * np.hanning(samples)))
        line = float(np.argmax(spectrum[1:]) + 1) * rate / samples
        for _ in range(5):
            first, second = windows @ (left * np.exp(-2j * np.pi * line * time))
            line += float(np.angle(second * first.conj())) / (2 * np.pi * half / rate)
        if (
            not 0 < line < rate / 2
            or np.min(np.abs(lines - line), initial=np.inf) < 2 * rate / samples
        ):
            break
        turns = 2 * np.pi * np.outer(np.append(lines, line), time)
        columns = np.concatenate([np.cos(turns), np.sin(turns)])
        rest = (
            angle
            - angle.mean()
            - np.linalg.lstsq(columns.T, angle - angle.mean(), rcond=None)[0] @ columns
        )
        if np.sum(left**2) - np.sum(rest**2) < WEAK * total:
            break
        lines, left = np.append(lines, line), rest
    return lines
