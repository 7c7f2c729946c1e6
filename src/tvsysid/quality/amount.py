"""Check amount of data, excitation, and the mean over realizations."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.numerics.moments import sliding_sum
from tvsysid.numerics.pseudoinverse import RIDGE
from tvsysid.numerics.spectra import PowerSpectrum
from tvsysid.quality.checks import FAULTS, Measured, NotApplicable, check, indices
from tvsysid.quality.fit import constant_impedance
from tvsysid.quality.fitted import MIN_EXPLAINED, NO_RESPONSE, NOT_IDENTIFIABLE, FittedEnsemble
from tvsysid.quality.statistics import SIGNIFICANT, p_value, p_value_of
from tvsysid.signals import Array

MAX_RELATIVE_ERROR = 9.99  # shown
NOISE_BAND = 0.25  # of the sampling rate: above, a joint hardly moves, but sensors have noise
DIGITS = 9  # after the point, in standard deviations, in which copies agree
MAX_RATIO = 1e6  # shown
STILL_POWER = 1e-6  # share of the angle's mean power below which it does not move
# Variance inflation of stiffness by velocity and acceleration, above which it is unknown, and the
# share of samples that may have it.
MAX_INFLATION, MAX_RINGING = 15.0, 0.01
ENOUGH_REALIZATIONS = 20  # to see how the angle moves
STEP_S, MIN_WINDOW_S = 0.01, 0.05  # of differences that stand for derivatives; to either side


@check(
    "few-realizations",
    "Few realizations",
    "realizations",
    15,
    "realizations",
    effect="the random error falls with the square root of their number; methods that look at each "
    "time by itself need more realizations than they have lags",
    remedy="record more, or cut shorter realizations if the behaviour repeats more often",
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
    effect="the random error of the stiffness is large",
    remedy="perturb more strongly, record more realizations, and check that these are the right "
    "channels and that every realization was perturbed anew",
    wrong="below",
)
def weak_answer(data: FittedEnsemble) -> Measured:
    """Return the share of the torque that a second-order joint explains."""
    share = 100 * data.explained
    what = f"stiffness, viscosity and inertia explain {share:.1f} % of the torque's variance"
    return Measured(share, what)


@check(
    "narrow-excitation",
    "The perturbation leaves the impedance undetermined",
    "relative standard error of the mean stiffness or inertia, whichever is larger",
    20,
    "%",
    effect="stiffness, viscosity and inertia are not separately identifiable; none of them can be "
    "trusted",
    remedy="use a perturbation with power from below 2 Hz to above the joint's natural frequency, "
    "some 10 Hz at the ankle",
)
def narrow_excitation(data: FittedEnsemble) -> Measured:
    """Return the relative error of mean stiffness or inertia, by the better of two fits.

    One of them is whitened.
    """
    data.require()
    if not np.isfinite(data.mean_impedance[0]).all():
        return Measured(100 * MAX_RELATIVE_ERROR, NOT_IDENTIFIABLE)
    whitened = (data.whitened(data.fit.motion), data.whitened(data.fit.torque))
    fits = np.array([data.mean_impedance, constant_impedance(*whitened)])[:, :, [0, 2]]
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nan_to_num(np.abs(fits[:, 1] / fits[:, 0]), nan=np.inf)
    best = np.argmin(relative.max(axis=1))
    worst = np.argmax(relative[best])
    value, error = fits[best, :, worst]
    size = 100 * min(relative[best, worst], MAX_RELATIVE_ERROR)
    name, unit = ("inertia", "kg·m²") if worst else ("stiffness", "N·m/rad")
    what = f"the data give a mean {name} of {value:.3g} ± {error:.2g} {unit}, ± {size:.2g} %"
    return Measured(size, what)


@check(
    "same-perturbation",
    "The same perturbation in every realization",
    "share of the angle's variance that is common to all realizations, or white as sensor noise is",
    30,
    "%",
    effect="a response to the angle cannot be separated from what repeats anyway; once the mean is "
    "subtracted, only noise is left",
    remedy="draw a new random perturbation for every realization; these data cannot be repaired",
)
def same_perturbation(data: FittedEnsemble) -> Measured:
    """Return the share of the angle that repeats, or is noise, where no torque responds to it."""
    edge, given = NOISE_BAND * data.rate, data.ensemble
    white = 100 * PowerSpectrum.of(data.core("angle"), data.rate).shares((edge, np.inf))[0]
    shares = {
        f"{white:.0f} % of the variance by which the angle differs between realizations lies above "
        f"{edge:g} Hz": white
    }
    if not given.mean_subtracted:
        varying = given.angle[:, given.core] - given.angle[:, given.core].mean()
        common = np.mean(varying.mean(axis=0) ** 2) / np.mean(varying**2) - 1 / len(data)
        common = 100 * max(0.0, common)
        shares[f"{common:.0f} % of the angle's variance is common to all realizations"] = common
    what = max(shares, key=shares.__getitem__)
    if data.explained >= MIN_EXPLAINED:
        return Measured(0.0, f"{what}, but the torque responds to what differs")
    return Measured(shares[what], f"{what}, and {NO_RESPONSE} where realizations differ")


@check(
    "repeated-realizations",
    "Realizations are repeated",
    "realizations whose angle and torque are copies of another one",
    0,
    "realizations",
    effect="the same noise counts twice: bands and random errors come out too small",
    remedy="keep one of each (ensemble.select), and check whether a file was read twice",
)
def repeated_realizations(data: FittedEnsemble) -> Measured:
    """Count the realizations that are an earlier one, to rounding."""
    given = data.given
    scaled = []
    for values in (given.angle, given.torque):
        size = values.std()
        scaled.append(np.round(values[:, given.core] / (size if size > 0 else 1.0), DIGITS))
    _, first, which = np.unique(
        np.concatenate(scaled, axis=1), axis=0, return_index=True, return_inverse=True
    )
    original = first[which.ravel()]
    copies = indices(np.arange(len(given)) != original)
    verb = "is" if len(copies) == 1 else "are"
    what = f"{len(copies)} of {len(given)} realizations {verb} the same as another one"
    if copies:
        what += f", first realization {copies[0]}, as realization {original[copies[0]]}"
    return Measured(len(copies), what, realizations=copies)


@check(
    "mean-angle",
    "A mean angle is left",
    "RMS of the angle's mean over realizations, over the RMS expected by chance",
    2.5,
    "times",
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
    effect="voluntary or passive torque that all realizations share counts as a response to the "
    "angle, and biases the stiffness",
    remedy="ensemble = tv.preprocess.subtract_mean(ensemble)",
    which="torque",
)
def mean_left(data: FittedEnsemble, which: str) -> Measured:
    """Compare the mean over realizations with what chance leaves of it.

    Noise is alike at neighbouring times and does not average out over time. Hence a limit above 1,
    and a test over realizations. A common offset shows in the means of realizations long before it
    does at single times.
    """
    data.require(MIN_TESTED_REALIZATIONS, response=False)
    if data.ensemble.mean_subtracted:
        raise NotApplicable("the mean over realizations has been subtracted")
    values = data.ensemble.signal(which)[:, data.ensemble.core]
    count, unit = len(values), {"angle": "rad", "torque": "N·m"}[which]
    size = np.sqrt(np.mean(values.mean(axis=0) ** 2))
    expected = math.sqrt(values.var(axis=0, ddof=1).mean() / count)
    ratio = size / expected if expected > 0 else math.inf
    beyond = FAULTS[f"mean-{which}"].beyond(ratio)
    # Products of each realization with the mean of the others, without its neighbours.
    place = np.arange(count)
    near = np.abs(np.subtract.outer(place, place)) <= 1
    shared = np.where(near, 0.0, values @ values.T).sum(axis=1)
    significant = beyond and p_value_of(shared) < SIGNIFICANT
    offsets = values.mean(axis=1)
    offset, error = abs(offsets.mean()), offsets.std(ddof=1) / math.sqrt(count)
    if offset > 0 and p_value(offset, error, count) < SIGNIFICANT / 10:
        significant, ratio = True, max(ratio, offset / error if error > 0 else math.inf)
    what = (
        f"the mean over realizations has an RMS of {size:.2g} {unit}; chance would leave "
        f"{expected:.2g}"
    )
    return Measured(min(ratio, MAX_RATIO), what, significant)


def unmoved_times(data: FittedEnsemble) -> Iterator[str]:
    """Yield remarks on times at which the movement does not determine the stiffness."""
    still = still_samples(data.core("angle"))
    if len(still):
        yield (
            f"the angle is still in all realizations at {len(still)} of {data.ensemble.samples} "
            f"samples, the first at {still[0] / data.rate:.3g} s: no stiffness is identifiable "
            "there"
        )
    ringing = np.mean(angle_inflation(data.angle, data.rate) > MAX_INFLATION)
    if ringing > MAX_RINGING:
        yield (
            f"at {100 * ringing:.0f} % of the samples the angle moves like a free oscillation: "
            "stiffness there comes from other times or from noise, and no band counts that; "
            "perturb without rests and at more frequencies, or take the joint as constant (pc)"
        )


def still_samples(angle: Array) -> NDArray[np.intp]:
    """Return samples at which no realization of the angle (realization, time) moves."""
    power = np.einsum("rt,rt->t", angle, angle)
    return np.flatnonzero(power < STILL_POWER * power.mean())


def angle_inflation(angle: Array, rate: float) -> Array:
    """Return the variance inflation of a regression on the angle by velocity and acceleration.

    The factors have shape (window,). They come from second moments of the angle (realization,
    time) over realizations and windows, longer for few realizations. They are 1 to 10 where noise,
    pulses or sines move a joint, and infinite where it rings freely or moves at one frequency.
    """
    angle = angle[:: max(1, len(angle) // ENOUGH_REALIZATIONS)]
    step = max(1, min(round(STEP_S * rate), (angle.shape[1] - 1) // 2))
    reach = max(MIN_WINDOW_S, 1 / len(angle))
    before, now, after = angle[:, : -2 * step], angle[:, step:-step], angle[:, 2 * step :]
    motion = np.stack([now, after - before, after - 2 * now + before])
    half = max(0, min(round(reach * rate), (now.shape[1] - 1) // 2))
    middles = slice(half, now.shape[1] - half, max(1, half))
    moments = sliding_sum(np.einsum("art,brt->tab", motion, motion), half, half)[middles]
    scale = np.sqrt(np.einsum("taa->ta", moments))
    scale[scale == 0] = np.inf
    correlation = moments / (scale[:, :, None] * scale[:, None, :])
    correlation[:, range(3), range(3)] = 1 + RIDGE
    return np.asarray(np.linalg.inv(correlation)[:, 0, 0])
