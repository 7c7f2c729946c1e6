"""Check amount of data, excitation, and the mean over realizations."""

from __future__ import annotations

import math

import numpy as np

from tvsysid.numerics.spectra import power_share
from tvsysid.quality.checks import Measured, NotApplicable, check
from tvsysid.quality.fit import (
    MIN_EXPLAINED,
    SI_UNITS,
    FittedEnsemble,
    constant_impedance,
)
from tvsysid.quality.statistics import TINY

MAX_RELATIVE_ERROR = 9.99  # shown
NOISE_BAND = 0.25  # of the sampling rate: above, a joint hardly moves, but sensors have noise
MIN_CHANCE = 1e-6  # least RMS expected by chance, as a share of the mean's RMS
DIGITS = 9  # decimals in which copies agree, in standard deviations


@check(
    "few-realizations",
    "Few realizations",
    "realizations",
    15,
    "realizations",
    "minor",
    effect="the random error is large; eirf needs more realizations than it has lags",
    remedy="record more, or cut shorter realizations if the movement repeats more often",
    wrong="below",
)
def few_realizations(data: FittedEnsemble) -> Measured:
    """Count the realizations."""
    return Measured(len(data), f"there are {len(data)} realizations")


@check(
    "weak-answer",
    "The torque hardly responds to the angle",
    "share of the torque that stiffness, viscosity and inertia explain",
    30,
    "%",
    "serious",
    effect="the random error of the stiffness is large",
    remedy="perturb or record more; check the channels, and that each realization was perturbed",
    wrong="below",
)
def weak_answer(data: FittedEnsemble) -> Measured:
    """Return the share of the torque that a second-order joint explains."""
    share = 100 * data.fit.explained
    return Measured(
        share, f"stiffness, viscosity and inertia explain {share:.1f} % of the torque's variance"
    )


@check(
    "narrow-excitation",
    "The perturbation leaves the impedance undetermined",
    "relative standard error of the mean stiffness or inertia, whichever is larger",
    20,
    "%",
    "serious",
    effect="stiffness, viscosity and inertia are not separately identifiable: trust none of them",
    remedy="perturb with power from below 2 Hz to above the natural frequency (ankle: 10 Hz)",
)
def narrow_excitation(data: FittedEnsemble) -> Measured:
    """Return the relative error of mean stiffness or inertia, by the better of two fits.

    One of them is whitened.
    """
    data.require(0)
    fit = data.fit
    whitened = constant_impedance(fit.whitened(fit.motion), fit.whitened(fit.torque))
    values, errors = np.array([fit.mean_impedance, whitened])[:, :, [0, 2]].swapaxes(0, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        worst = np.nan_to_num(np.abs(errors / values), nan=np.inf).max(axis=1)
    size = 100 * min(worst.min(), MAX_RELATIVE_ERROR)
    return Measured(size, f"the data give the mean stiffness and the inertia to ± {size:.2g} %")


@check(
    "same-perturbation",
    "The same perturbation in every realization",
    "share of noise in the angle's deviations from its mean, if the torque hardly responds",
    30,
    "%",
    "minor",
    effect="a response to the angle cannot be separated from what repeats anyway; once the mean is "
    "subtracted, only noise is left",
    remedy="draw a new random perturbation for every realization; these data cannot be repaired",
)
def same_perturbation(data: FittedEnsemble) -> Measured:
    """Return the share of noise in the angle's deviations, 0 if the torque responds to them."""
    edge = NOISE_BAND * data.rate
    white = 100 * power_share(data.core("angle"), data.rate, edge)
    return Measured(
        0.0 if data.fit.explained >= MIN_EXPLAINED else white,
        f"{white:.0f} % of the angle's variance about its mean over realizations lies above "
        f"{edge:g} Hz",
    )


@check(
    "repeated-realizations",
    "Realizations are repeated",
    "realizations whose angle and torque are copies of another one",
    0,
    "realizations",
    "minor",
    effect="the same noise counts twice: bands and random errors come out too small",
    remedy="keep one of each (ensemble.select), and check whether a file was read twice",
)
def repeated_realizations(data: FittedEnsemble) -> Measured:
    """Count the realizations that are an earlier one, to rounding."""
    signals = np.stack([data.given.angle, data.given.torque])[..., data.given.core]
    size = signals.std(axis=(1, 2), keepdims=True)
    rounded = np.round(signals / np.where(size > 0, size, 1), DIGITS)
    first = np.unique(rounded.swapaxes(0, 1), axis=0, return_index=True)[1]
    copies = np.setdiff1d(np.arange(len(data)), first)
    what = f"{len(copies)} of {len(data)} realizations are the same as another one"
    return Measured(len(copies), what, realizations=tuple(copies.tolist()))


@check(
    "mean-angle",
    "A mean angle is left",
    "RMS of the angle's mean over realizations, over the RMS expected by chance",
    2.5,
    "times",
    "doubtful",
    effect="an offset or an imposed movement counts as perturbation, and biases the stiffness",
    remedy="ensemble = tv.preprocess.subtract_mean(ensemble)",
    which="angle",
)
@check(
    "mean-torque",
    "A mean torque is left",
    "RMS of the torque's mean over realizations, over the RMS expected by chance",
    2.5,
    "times",
    "doubtful",
    effect="voluntary or passive torque that all realizations share counts as a response to the "
    "angle, and biases the stiffness",
    remedy="ensemble = tv.preprocess.subtract_mean(ensemble)",
    which="torque",
)
def mean_left(data: FittedEnsemble, which: str) -> Measured:
    """Compare the mean over realizations with what chance leaves of it.

    Noise is alike at neighbouring times and does not average out over time: hence a limit above 1.
    """
    if data.ensemble.mean_subtracted:
        raise NotApplicable("the mean over realizations has been subtracted")
    values = data.ensemble.signal(which)[:, data.ensemble.core]
    size = np.sqrt(np.mean(values.mean(axis=0) ** 2))
    expected = math.sqrt(values.var(axis=0, ddof=1).mean() / len(values))
    what = (
        f"the mean over realizations has an RMS of {size:.2g} {SI_UNITS[which]}; chance would "
        f"leave {expected:.2g}"
    )
    return Measured(size / max(expected, MIN_CHANCE * size, TINY), what)
