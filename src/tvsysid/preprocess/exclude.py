"""Align realizations to the torque that they should have followed.

Exclude those far off or unlike the rest.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.preprocess.account import Account, Step
from tvsysid.preprocess.segment import check_seconds, every_signal
from tvsysid.signals import Array, Ensemble

ORDER = 3


def align(ensemble: Ensemble, reference: str, search: float = 0.5, max_shift: float = 0.25) -> Step:
    r"""Shift each realization to where its torque is nearest to the reference, and exclude those that are far off.

    .. math:: \tau_r = \arg\min_{|\tau| \le \text{search}} \sum_t (y_r(t + \tau) - y_\text{ref}(t))^2

    (equation 27 of van de Ruit et al. 2021). Angle, torque and channels move together by whole
    samples; the reference stays. What moves in from either side was recorded there: it comes from
    the ensemble's context, which is shorter by ``search`` afterwards. Onsets are shifted as well,
    so that realizations that moved apart no longer follow each other.

    Parameters
    ----------
    ensemble
        With a context of at least ``search``.
    reference
        Name of the channel that holds the torque to follow, in N·m.
    search
        Largest shift tried, in s.
    max_shift
        Realizations that need a larger shift (in s) are excluded.

    Notes
    -----
    The torque that answers the perturbation also moves the best fit, by some 7 ms (SD). A shift by that much adds
    voluntary torque that cancels the answer's part at the task's frequency, and so lowers the identified stiffness: by
    15 % for a virtual participant who follows the target perfectly. Where that matters, exclude by the shift but
    leave the realizations where they were: ``preparation.recorded.select(preparation.account.kept)``.
    """
    check_seconds("align", positive=True, search=search, max_shift=max_shift)
    if reference not in ensemble.channels:
        raise InputError(
            f"align: there is no channel {reference!r} to align to; "
            f"channels: {', '.join(map(repr, ensemble.channels)) or 'none'}; without a torque to "
            "follow, leave it out"
        )
    rate = ensemble.sampling_rate
    reach = round(search * rate)
    if ensemble.context < reach:
        raise InputError(
            f"align: shifts of up to {search:g} s need that much context, but the realizations "
            "have "
            f"{ensemble.context / rate:g} s; segment with more context"
        )
    assert ensemble.onsets is not None
    core = ensemble.core
    target = ensemble.channels[reference][:, core]
    shifts = _best_shifts(ensemble.torque[:, core.start - reach : core.stop + reach], target)
    left = ensemble.angle.shape[1] - 2 * reach
    index = np.arange(reach, reach + left) + shifts[:, None]

    def moved(x: Array) -> Array:
        return x[np.arange(len(x))[:, None], index]

    signals = every_signal(ensemble, moved)
    signals["channels"][reference] = ensemble.channels[reference][:, reach : reach + left]
    aligned = attrs.evolve(
        ensemble,
        **signals,
        context=ensemble.context - reach,
        onsets=ensemble.onsets + shifts / rate,
    )
    account = attrs.evolve(
        Account.of(ensemble, "alignment", np.abs(shifts) / rate, max_shift, "s"),
        shifts=shifts / rate,
    )
    if not account.kept.any():
        raise InputError(
            f"align: every realization needs a shift of more than {max_shift:g} s; "
            f"are the signs of the torque and of channel {reference!r} the same, and their times?"
        )
    return Step(
        aligned.select(account.kept), account, aligned.torque[:, aligned.core], target.mean(axis=0)
    )


def _best_shifts(torque: Array, target: Array) -> NDArray[np.int64]:
    """Shift in samples that brings each torque nearest to its target, positive where the torque comes late.

    From -reach to reach, for torques (realization, reach + time + reach) and targets
    (realization, time).
    """
    samples = target.shape[1]
    windows = sliding_window_view(torque, samples, axis=1)
    # The target's own power is the same for all shifts.
    errors = np.einsum("rst,rst->rs", windows, windows) - 2 * np.einsum(
        "rst,rt->rs", windows, target
    )
    return np.asarray(np.argmin(errors, axis=1) - (torque.shape[1] - samples) // 2)


def exclude_task_outliers(ensemble: Ensemble, limit: float = 3.0) -> Step:
    """Exclude realizations whose torque at the task's frequency leaves the ensemble's mean and spread at any time.

    The task repeats once in a realization: its component is the first harmonic of the realization,
    all others set to zero.

    Parameters
    ----------
    ensemble
        At least two realizations, aligned; the voluntary torque still in it.
    limit
        Largest distance from the mean over realizations, in standard deviations, at any time.

    Notes
    -----
    Mean and standard deviation are those of all realizations given, and are not computed again without the outliers.
    Even if all is Gaussian some 1 in 90 realizations (exp(-4.5)) reaches 3 SD, because the component has two degrees of
    freedom.
    """
    return _exclude(
        "task component", ensemble, task_component(ensemble.torque[:, ensemble.core]), limit
    )


def exclude_residual_outliers(ensemble: Ensemble, cutoff: float = 5.0, limit: float = 3.0) -> Step:
    """Exclude realizations whose slow torque leaves the ensemble's mean and spread at any time.

    The torque passes a third-order low-pass Butterworth filter forwards and backwards, which delays
    nothing; it begins and ends in the context.

    Parameters
    ----------
    ensemble
        Deviations from the mean over realizations, of at least two.
    cutoff
        -3 dB frequency of the filter's single pass in Hz, below half the sampling rate.
    limit
        Largest distance from the mean over realizations, in standard deviations, at any time.

    Notes
    -----
    Two seconds of torque below 5 Hz hold some 20 independent values, so that 10 % of Gaussian realizations reach 3 SD
    somewhere though none is unlike the others: 30 of 300, where van de Ruit et al. 2021 excluded 15 to 29. A limit of
    4 SD takes 0.4 % of them.
    """
    rate = ensemble.sampling_rate
    if not 0 < cutoff < rate / 2:
        raise InputError(
            f"exclude_residual_outliers: cutoff must be between 0 and {rate / 2:g} Hz, got "
            f"{cutoff!r}"
        )
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415  # heavy

    sections = butter(ORDER, cutoff, fs=rate, output="sos")
    # A second of odd continuation at most; the default would forget the filter's slow start.
    padding = min(round(rate), ensemble.torque.shape[1] - 1)
    slow = sosfiltfilt(sections, ensemble.torque, axis=1, padlen=padding)[:, ensemble.core]
    return _exclude("residual", ensemble, slow, limit)


def task_component(torque: Array) -> Array:
    """First harmonic of each realization in N·m, shape (realization, time)."""
    spectrum = np.fft.rfft(torque, axis=1)
    spectrum[:, 0] = 0
    spectrum[:, 2:] = 0
    return np.asarray(np.fft.irfft(spectrum, torque.shape[1], axis=1))


def _exclude(step: str, ensemble: Ensemble, judged: Array, limit: float) -> Step:
    """Exclude realizations that leave mean ± limit · SD over realizations at any time."""
    if not (isinstance(limit, (int, float, np.number)) and math.isfinite(limit) and limit > 0):
        raise InputError(
            f"{step}: limit must be a positive number of standard deviations, got {limit!r}"
        )
    if len(judged) < 2:
        raise InputError(
            f"{step}: expected at least two realizations to tell which are unlike the others, got "
            "one"
        )
    mean, sd = judged.mean(axis=0), judged.std(axis=0, ddof=1)
    distance = np.abs(judged - mean)
    reached = np.divide(distance, sd, out=np.zeros_like(distance), where=sd > 0).max(axis=1)
    account = Account.of(ensemble, step, reached, limit, "SD")
    if not account.kept.any():
        raise InputError(
            f"{step}: every realization leaves the mean by {limit:g} SD somewhere; give a higher "
            "limit"
        )
    return Step(ensemble.select(account.kept), account, judged, mean, limit * sd)
