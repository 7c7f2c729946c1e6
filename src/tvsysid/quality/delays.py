"""Whether both channels are of one time."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress

import numpy as np
from scipy.ndimage import gaussian_filter1d

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.numerics.interpolation import SINC, between
from tvsysid.quality.catalogue import FAULTS
from tvsysid.quality.fitted import (
    ANSWERED,
    NO_ANSWER,
    SMOOTH,
    FittedEnsemble,
    NotJudged,
    SecondOrder,
    Seen,
    fit_motion,
)
from tvsysid.quality.statistics import SIGNIFICANT, p_value, p_value_of
from tvsysid.quality.structure import feedback
from tvsysid.signals import Array

LONGEST_DELAY = 0.1  # in s, to either side
CLEARER = 1.3  # times as much as with the best shift that a joint must leave unexplained without it
# times as much, or as little, inertia behind a low-pass: noise in the angle hides some, a delay
# does not
HIDDEN = 1.25
LARGE = 15.0  # ms: no noise in the angle looks like so large a delay
SHIFTED = 0.3  # % of the torque that later movement predicts, in a loop, if the torque is shifted
FINER = np.linspace(-1, 1, 9)  # samples beside the best shift that are tried
STEPS, LONGEST_STEP = 3, 1.5  # Gauss-Newton steps, and how many samples each may go
PARTS = 10  # of a realization, over which a delay must not scatter more than over realizations
# the same from which on the steps start at the best shift, which is too far from none for them
FAR = 1.05
# share of a delay that the next step may be: what noise or a misfit looks like goes on and on
SETTLED = 0.015
MOST_TOLD = 200  # % of a value beyond which a change of it is not told as a share


def delay(data: FittedEnsemble) -> Seen:
    r"""Delay of the torque with which a joint of second order leaves least of it.

    A delay by d adds the jerk to the regressors: :math:`y(t - d) \approx k\theta + (b - k
    d)\dot\theta + (I - b d + k d^2/2)\ddot\theta - I d\,\dddot\theta`, which no stiffness,
    viscosity or inertia answers; so it is known to some tenths of a millisecond even at 100 Hz.
    It is as true as the model is: a joint that is not of second order, or a torque that moves
    the angle, has such a part too. So a delay must also come out where other frequencies count
    more, when the noise is not whitened, and an early torque in a closed loop is not judged.
    """
    shift, best = _best_shift(data)
    clear = data.fit.left >= CLEARER * best.left
    samples = shift if data.fit.left > FAR * best.left else 0.0
    for _ in range(STEPS):
        step, _, _ = _remaining(data.synchronised(samples))
        samples += float(np.clip(step, -LONGEST_STEP, LONGEST_STEP))
    timely = data.synchronised(samples)
    step, error, apart = (1000 * each / data.rate for each in _remaining(timely))
    late = 1000 * samples / data.rate
    significant = p_value(late, error, len(data)) < SIGNIFICANT and abs(late) > max(
        abs(apart), abs(step) / SETTLED
    )
    if significant and (reason := _other_cause(data, timely, late, clear)):
        raise NotJudged(reason)
    edge = "at least " if abs(round(samples)) >= _reach(data) else ""
    what = f"the torque is {edge}{abs(late):.3g} ± {error:.1g} ms {'late' if late > 0 else 'early'}"
    if abs(apart) > max(error, FAULTS["delay"].limit):
        what += f" ({late + apart:+.2g} ms where lower frequencies count more)"
    return Seen(late, what + _cost(data, timely), significant)


def _remaining(data: FittedEnsemble) -> tuple[float, float, float]:
    """Return the remaining delay in samples, its standard error, and the effect of whitening.

    The effect is by how much the delay is longer if the noise is not whitened.
    """
    torque = data.fit.parts.sum(axis=0)
    change = between(torque, -0.5) - between(torque, 0.5)

    def fitted(signal: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Return the step at each sample times its weight, and the weight.

        ``signal`` turns each signal into the one that is fitted, for example a whitened one.
        """
        parts, left, later = (
            gaussian_filter1d(signal(each), SMOOTH, axis=-1)
            for each in (data.fit.parts, data.fit.residual, change)
        )
        alone, left = (
            fit_motion(parts, each, data.rate, 0).residual[:, SINC:-SINC] for each in (later, left)
        )
        return left * alone, alone**2

    moments, weights = fitted(data.whitened)
    plain, plain_weights = fitted(lambda values: values)
    if weights.sum() <= 0 or plain_weights.sum() <= 0:
        raise NotJudged(NO_ANSWER)
    step = float(moments.sum() / weights.sum())
    # A misfit is alike in all realizations, and differs from time to time.
    apart = moments - step * weights
    parts = np.array([each.sum() for each in np.array_split(apart, PARTS, axis=1)])
    scatter = (
        float(np.sum(each**2)) * len(each) / (len(each) - 1) for each in (apart.sum(axis=1), parts)
    )
    error = math.sqrt(max(scatter)) / float(weights.sum())
    return step, error, float(plain.sum() / plain_weights.sum()) - step


def _other_cause(data: FittedEnsemble, timely: FittedEnsemble, late: float, clear: bool) -> str:
    """Describe what else in these data looks like a delay of ``late`` ms.

    ``clear`` is False for a delay that does not make the fit clearly better.
    """
    inertia, smooth = (
        float(values[2]) for values, _ in (timely.mean_impedance, timely.smooth_impedance)
    )
    if (abs(late) < LARGE or not clear) and not inertia / HIDDEN < smooth < HIDDEN * inertia:
        return (
            "noise in the angle (coarse steps, spikes), or a torque smoothed alone, looks like "
            "a delay"
        )
    with suppress(NotJudged):
        # A loop shows in what is shifted, too; or as it is, where a shift hardly helps.
        if late < -FAULTS["delay"].limit and (
            feedback(timely).value > SHIFTED
            or (not clear and FAULTS["feedback"].beyond(feedback(data).value))
        ):
            return "torque noise moves the angle, which looks like an early torque"
    return ""


def _cost(given: FittedEnsemble, timely: FittedEnsemble) -> str:
    """What the delay does to inertia and viscosity, in words."""
    texts = []
    for name, unit, place in (("inertia", "kg·m²", 2), ("viscosity", "N·m·s/rad", 1)):
        as_given, corrected = (float(each.mean_impedance[0][place]) for each in (given, timely))
        share = 100 * (as_given - corrected) / abs(corrected) if corrected else math.inf
        told = f" ({share:+.0f} %)" if abs(share) < MOST_TOLD else ""
        texts.append(f"{name} {as_given:.3g} instead of {corrected:.3g} {unit}{told}")
    return f"; that makes {' and '.join(texts)}"


def clock_skew(data: FittedEnsemble) -> Seen:
    """Best shift of the second half of the experiment against that of the first."""
    data.require(2 * MIN_TESTED_REALIZATIONS, answer=False)
    (first_shift, first), (second_shift, second) = map(_best_shift, data.halves)
    # What each half leaves with the other's shift, against what it leaves with its own.
    trades = zip(data.halves, (second_shift, first_shift), (first, second), strict=True)
    worse = [
        half.regressors.fit(_later(half, others)).squares - own.squares
        for half, others, own in trades
    ]
    skew = 1000 * second_shift / data.rate - 1000 * first_shift / data.rate
    what = (
        f"the torque is {skew:.3g} ms late in the second half of the experiment against the first"
    )
    return Seen(skew, what, p_value_of(np.concatenate(worse)) < SIGNIFICANT)


def _reach(data: FittedEnsemble) -> int:
    """Samples that are tried as a delay, to either side."""
    reach = min(round(LONGEST_DELAY * data.rate), data.ensemble.context)
    if reach < 2:
        raise NotJudged("the realizations have no context to shift them by")
    return reach


def _later(data: FittedEnsemble, samples: float) -> Array:
    """Torque taken so many samples later, where it was fitted."""
    fit, whole = data.fit, round(samples)
    torque = between(data.torque, samples - whole)
    late = np.clip(
        np.arange(fit.first, fit.first + fit.torque.shape[1]) + whole, 0, torque.shape[1] - 1
    )
    return torque[:, late]


def _best_shift(data: FittedEnsemble) -> tuple[float, SecondOrder]:
    """Shift of the torque in samples that leaves least of it, and the fit with it."""
    reach, regressors = _reach(data), data.regressors

    def best_of(shifts: Array) -> float:
        return float(min(shifts, key=lambda shift: regressors.left(_later(data, float(shift)))))

    best = best_of(np.arange(-reach, reach + 1).astype(np.float64))
    best = best_of(np.clip(best + FINER, -reach, reach))
    fit = regressors.fit(_later(data, best))
    if 1 - fit.left < ANSWERED:
        raise NotJudged(NO_ANSWER)
    return best, fit
