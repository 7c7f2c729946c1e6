"""Skirt decomposition: how the response to each line of a multisine changes in time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import block_diag, inv
from scipy.special import chdtrc

from tvsysid.methods import base, shared
from tvsysid.models import Diagnostics, Model
from tvsysid.numerics.bases import FourierSeries, evaluate
from tvsysid.signals import Array, Ensemble

MAX_LINES = 20
MIN_SHARE = 0.99  # of the angle's power in its lines
MIN_HEIGHT = 0.01  # of a line, relative to the highest
MIN_BINS = 8  # of the spectrum between lines, beyond the side lobes of the window
ROUNDS = 5  # in which a line's frequency is refined, and the noise's density
FITTED_P, WARNED_P = 0.05, 1e-4  # p-values below which skirts are fitted, and warned of
NOISELESS = 1e-5  # relative variance below which the residual is rounding and filters
ON_GRID = 0.02  # of 1/period: frequencies this close to its multiples count as such
NEAR_HZ = 2.0  # distance from a line within which the residual gives its noise


@attrs.frozen
class SkirtDecomposition(base.Method):
    r"""Identify the response to each line of a multisine. Its change widens the line into a skirt.

    .. math:: y(t) = \sum_k \mathrm{Re}\{G_k(t)\, U_k\, e^{j\omega_k t}\}, \qquad
              G_k(t) = \sum_{h=-H}^{H} g_{kh}\, e^{2\pi j h t / p}
              = k(t) + j\omega_k\, b(t) - I\,\omega_k^2

    Stiffness and viscosity, as sums of harmonics, and a constant inertia are fitted to the torque
    of all lines by least squares, weighted by the noise near each line. The lines and their
    complex amplitudes U are estimated from the angle. So filters that angle and torque pass alike
    do not matter.

    Notes
    -----
    H is the highest harmonic of the period p (the duration of a realization) whose skirts the
    torque shows; ``harmonics`` among the diagnostics' details has it. Skirts may not overlap: lines
    must be more than 2 H / p apart. A warning says where skirts are left.

    The imposed angle must be a multisine and nothing else (to 1 % of its variance), in one trial,
    with one or more frequencies for each of stiffness and inertia.
    With its few unknowns, the method is better than ``kbr`` for a slow change of known smoothness,
    and worse for any other change. docs/special-perturbations.md has figures.

    The bands count the residual's power within 2 Hz of each line.

    References
    ----------
    Lataire, Pintelon & Louarroudi 2012, Automatica 48, 783-791.
    """

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
        lines = Lines.of(ensemble)
        if lines.share >= MIN_SHARE and len(lines.frequencies) >= 2:
            return None
        return (
            "the angle is no multisine of two or more lines, without which stiffness is not told "
            f"from inertia: the {len(lines.frequencies)} found explain {100 * lines.share:.1f} % "
            f"of it, and {100 * MIN_SHARE:g} % are needed; perturb with some sines of fixed "
            "frequencies and impose the angle"
        )

    def fit(self, ensemble: Ensemble) -> Model:
        """Return the model of an ensemble."""
        lines, shown = Lines.of(ensemble), [0]
        # Distance of lines, in harmonics of the period
        room = float(np.diff(np.sort(lines.frequencies)).min()) * ensemble.duration - ON_GRID
        while shown:  # until no further harmonic has skirts
            harmonics = max(shown)
            fit = SkirtFit.of(ensemble, lines, harmonics)
            # Skirts that do not meet those that are fitted
            tested = range(harmonics + 1, math.ceil(room) - harmonics)
            p_values = {each: fit.p_value(lines, [each, -each]) for each in tested}
            shown = [each for each, p in p_values.items() if 2 * each < room and p < FITTED_P]
        left = [f"skirts of harmonic {each}" for each, p in p_values.items() if p < WARNED_P]
        agreement = fit.p_value(lines, range(-harmonics, harmonics + 1), len(fit.mean))
        left += ["lines that do not agree with each other"] * (agreement < WARNED_P)
        is_noisy = np.var(fit.residual) > NOISELESS * np.var(ensemble.torque[:, ensemble.core])
        warned = (
            f"the torque has {', '.join(left)}, where the impedance that is fitted changes by "
            f"{harmonics} harmonics, which no band counts: it changes faster, or is not of second "
            "order; use kbr"
        )
        features, samples = fit.features, ensemble.samples
        expansions = block_diag(features, features, np.ones((samples, 1))).reshape(3, samples, -1)
        errors = shared.posterior_errors(expansions, fit.covariance, fit.freedom, samples)
        return Model(
            method=repr(self),
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=shared.impedance_estimates((expansions @ fit.mean).T, errors),
            diagnostics=Diagnostics(
                float(len(fit.mean)),
                warnings=(warned,) if is_noisy and left else (),
                details={"lines": float(len(lines.frequencies)), "harmonics": float(harmonics)},
            ),
        )


class Lines(NamedTuple):
    """Lines of a multisine.

    ``frequencies`` (line,) are in Hz. ``waves`` (line, realization, time) are the lines as complex
    waves, fitted to the angle. ``share`` is that of the angle's power.
    """

    frequencies: Array
    waves: NDArray[np.complex128]
    share: float

    @classmethod
    def of(cls, ensemble: Ensemble) -> Lines:
        """Return the lines that are found in the angle."""
        angle = ensemble.angle[:, ensemble.core]
        lines = find_lines(angle[max(ensemble.runs, key=len)].ravel(), ensemble.sampling_rate)
        if ensemble.mean_subtracted:  # the mean contains lines at multiples of 1/period
            turns = lines * ensemble.duration
            lines = lines[np.abs(turns - np.round(turns)) > ON_GRID]
        time = ensemble.onsets[:, None] + ensemble.time
        waves = np.exp(2j * np.pi * lines[:, None, None] * time)
        if ensemble.mean_subtracted:  # as angle and torque have lost theirs
            waves -= waves.mean(axis=1, keepdims=True)
        columns = np.concatenate([waves.real, waves.imag, np.ones((1, *angle.shape))])
        columns = columns.reshape(len(columns), -1)
        weights = np.linalg.lstsq(columns.T, angle.ravel(), rcond=None)[0]
        share = 1 - np.var(angle.ravel() - weights @ columns) / np.var(angle)
        real, imaginary = weights[:-1].reshape(2, -1)
        return cls(lines, waves * (real - 1j * imaginary)[:, None, None], float(share))

    def columns(self, features: Array, weights: Array) -> Array:
        """Return the columns of stiffness, viscosity and inertia, shape (column, sample).

        They are angle, velocity and acceleration, as sums over lines with these ``weights``
        (line,). Angle and velocity are multiplied by each function of time (time, function).
        """
        factors = weights * (2j * np.pi * self.frequencies) ** np.arange(3)[:, None]
        angle, velocity, acceleration = np.tensordot(factors, self.waves, 1).real
        changing = [each * function for each in (angle, velocity) for function in features.T]
        return np.stack([*changing, acceleration]).reshape(-1, angle.size)


class SkirtFit(NamedTuple):
    """Second-order response to all lines that is fitted to the torque.

    ``features`` (time, function) are the functions of time. ``mean`` (coefficient,) are the
    coefficients of stiffness and viscosity for each function, and the inertia, with their
    ``covariance`` and its degrees of freedom. The ``residual`` has shape (realization, time). Its
    ``density`` (line,) about each line is 1 for white noise of unit variance.
    """

    features: Array
    mean: Array
    covariance: Array
    density: Array
    freedom: float
    residual: Array

    @classmethod
    def of(cls, ensemble: Ensemble, lines: Lines, harmonics: int) -> SkirtFit:
        """Fit an impedance that changes by some harmonics of the period."""
        features = evaluate(FourierSeries(harmonics), ensemble.samples)
        torque = ensemble.torque[:, ensemble.core]
        torque = torque - torque.mean()
        spectrum = np.fft.rfftfreq(ensemble.samples, 1 / ensemble.sampling_rate)
        near = np.abs(np.subtract.outer(lines.frequencies, spectrum)) <= NEAR_HZ
        counts = shared.independent_realizations(ensemble) * near.sum(axis=1)
        density = np.ones(len(near))  # as if noise were white, the first time
        columns = lines.columns(features, density)
        for _ in range(ROUNDS):
            weighted = lines.columns(features, 1 / density)
            covariance = inv(weighted @ columns.T)
            mean = covariance @ (weighted @ torque.ravel())
            residual = torque - (mean @ columns).reshape(torque.shape)
            power = np.mean(np.abs(rfft(residual, axis=1)) ** 2, axis=0) / ensemble.samples
            density = len(ensemble) * (near @ power) / counts
        return cls(features, mean, covariance, density, 2.0 * counts.min(), residual)

    def p_value(self, lines: Lines, harmonics: Iterable[int], unknowns: int = 0) -> float:
        """Return the probability that noise alone leaves such skirts of some harmonics.

        ``unknowns`` is the number of coefficients that were fitted to them.
        """
        cycles = np.arange(self.residual.shape[1]) / self.residual.shape[1]
        turning = np.exp(2j * np.pi * np.outer([*harmonics], cycles))
        found = np.einsum("krt,ht,rt->hk", lines.waves.conj(), turning, self.residual)
        strength = self.density * np.sum(np.abs(lines.waves) ** 2, axis=(1, 2))
        misfit = 2 * np.sum(np.abs(found) ** 2 / strength)
        return float(chdtrc(2 * found.size - unknowns, misfit))


def find_lines(angle: Array, rate: float) -> Array:
    """Return the frequencies in Hz of the lines of a signal (time,), the strongest first.

    A line has the frequency at which the phase is the same in both halves of the signal.
    """
    samples, half = len(angle), len(angle) // 2
    spectrum = np.abs(rfft((angle - angle.mean()) * np.hanning(samples)))
    peaks, _ = scipy.signal.find_peaks(spectrum, MIN_HEIGHT * spectrum.max(), distance=MIN_BINS)
    lines: Array = peaks[np.argsort(-spectrum[peaks])[:MAX_LINES]] * rate / samples
    for _ in range(ROUNDS):
        turned = angle * np.exp(-2j * np.pi * np.outer(lines, np.arange(samples) / rate))
        parts = turned[:, : 2 * half].reshape(-1, 2, half) @ np.hanning(half)
        lines = lines + np.angle(parts[:, 1] * parts[:, 0].conj()) * rate / (2 * np.pi * half)
    return lines
