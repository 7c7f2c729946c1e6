"""Align realizations to a target torque, and exclude outliers."""

from __future__ import annotations

import attrs
import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.preprocess.trials import map_signals
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import positive


@attrs.frozen(eq=False)
class Step:
    """Result of one step that excludes realizations.

    Parameters
    ----------
    ensemble
        Realizations that were kept.
    kept
        Whether each realization given was kept, shape (realization given,).
    reached, limit
        Largest deviation of each realization, and the limit for it: in s for the alignment, else in
        standard deviations from the mean.
    judged
        Torque that was compared, in N·m, shape (realization given, time), without context.
    mean
        Its mean over realizations in N·m, shape (time,); for the alignment, the mean target.
    half_width
        Limit for the distance from the mean in N·m, shape (time,); None for the alignment.
    shifts
        Shift of each realization in s, positive where the torque came late.
    """

    ensemble: Ensemble
    kept: NDArray[np.bool_]
    reached: Array
    limit: float
    judged: Array
    mean: Array
    half_width: Array | None = None
    shifts: Array | float = 0.0


def align(ensemble: Ensemble, reference: str, search: float = 0.5, max_shift: float = 0.25) -> Step:
    r"""Shift each realization to where its torque is nearest to a target. Exclude large shifts.

    .. math:: \tau_r = \arg\min_{|\tau| \le \text{search}}
              \sum_t (y_r(t + \tau) - y_\text{ref}(t))^2

    (equation 27 of van de Ruit et al. 2021). Angle, torque and channels move together by whole
    samples; the reference stays. The samples that move in come from the context, which is shorter
    by ``search`` afterwards. Onsets are shifted too, so that realizations with different shifts no
    longer follow each other.

    Parameters
    ----------
    ensemble
        Realizations with a context of at least ``search``.
    reference
        Name of the channel with the target torque in N·m.
    search
        Largest shift tried, in s.
    max_shift
        Largest shift kept, in s. Realizations that need a larger one are excluded.

    Notes
    -----
    The response to the perturbation also moves the best fit, by some 7 ms (SD). Such a shift adds
    voluntary torque that cancels part of the response at the task's frequency. This lowers the
    identified stiffness, by 15 % for a virtual participant who follows the target perfectly. Where
    that matters, exclude by the shift but do not shift:
    ``preparation.recorded.select(preparation.kept)``.
    """
    positive.check("align", "search", search)
    positive.check("align", "max_shift", max_shift)
    if reference not in ensemble.channels:
        raise InputError(
            f"align: there is no channel {reference!r} to align to; channels: "
            f"{', '.join(map(repr, ensemble.channels)) or 'none'}; without a target, leave it out"
        )
    rate = ensemble.sampling_rate
    reach = round(search * rate)
    if ensemble.context < reach:
        raise InputError(
            f"align: shifts of up to {search:g} s need that much context, but the realizations "
            f"have {ensemble.context / rate:g} s; segment with more context"
        )
    core = ensemble.core
    target = ensemble.channels[reference][:, core]
    shifts = _best_shifts(ensemble.torque[:, core.start - reach : core.stop + reach], target)
    inner = np.arange(reach, ensemble.angle.shape[1] - reach)
    rows, index = np.arange(len(ensemble))[:, None], inner + shifts[:, None]
    signals = map_signals(ensemble, lambda values: values[rows, index])
    signals["channels"][reference] = ensemble.channels[reference][:, inner]
    aligned = attrs.evolve(
        ensemble,
        **signals,
        context=ensemble.context - reach,
        onsets=ensemble.onsets + shifts / rate,
    )
    reached, judged = np.abs(shifts) / rate, aligned.torque[:, aligned.core]
    kept = reached <= max_shift
    if not kept.any():
        raise InputError(
            f"align: every realization needs a shift of more than {max_shift:g} s; "
            f"do torque and channel {reference!r} have the same sign and the same times?"
        )
    mean = target.mean(axis=0)
    return Step(aligned.select(kept), kept, reached, max_shift, judged, mean, shifts=shifts / rate)


def _best_shifts(torque: Array, target: Array) -> NDArray[np.int64]:
    """Return the shift in samples that brings each torque nearest to its target.

    From -reach to reach, positive where the torque comes late, for torques of shape (realization,
    reach + time + reach) and targets of shape (realization, time).
    """
    samples = target.shape[1]
    windows = sliding_window_view(torque, samples, axis=1)
    # The target's own power is the same for all shifts.
    power = np.einsum("rst,rst->rs", windows, windows)
    errors = power - 2 * np.einsum("rst,rt->rs", windows, target)
    return np.asarray(np.argmin(errors, axis=1) - (torque.shape[1] - samples) // 2)


def exclude_task_outliers(ensemble: Ensemble, limit: float = 3.0) -> Step:
    """Exclude realizations whose torque at the task's frequency is an outlier at any time.

    The task repeats once in a realization: its component is the first harmonic.

    Parameters
    ----------
    ensemble
        At least two realizations, aligned, with their voluntary torque.
    limit
        Largest distance from the mean over realizations, in standard deviations.

    Notes
    -----
    Mean and standard deviation are those of all realizations given. They are not computed again
    without the outliers. Even if all is Gaussian, some 1 in 90 realizations (exp(-4.5)) reaches
    3 SD, because the component has two degrees of freedom.
    """
    torque = ensemble.torque[:, ensemble.core]
    spectrum = np.fft.rfft(torque, axis=1)
    spectrum[:, 0] = spectrum[:, 2:] = 0
    harmonic = np.fft.irfft(spectrum, torque.shape[1], axis=1)
    return _exclude("task component", ensemble, np.asarray(harmonic), limit)


def exclude_residual_outliers(ensemble: Ensemble, cutoff: float = 5.0, limit: float = 3.0) -> Step:
    """Exclude realizations whose slow torque is an outlier at any time.

    The torque passes a third-order low-pass Butterworth filter forwards and backwards, which delays
    nothing. The filter begins and ends in the context.

    Parameters
    ----------
    ensemble
        Deviations from the mean over realizations, of at least two.
    cutoff
        -3 dB frequency of the filter's single pass in Hz, below half the sampling rate.
    limit
        Largest distance from the mean over realizations, in standard deviations.

    Notes
    -----
    Two seconds of torque below 5 Hz hold some 20 independent values. Therefore 10 % of Gaussian
    realizations reach 3 SD somewhere though none is an outlier: 30 of 300, where van de Ruit et al.
    2021 excluded 15 to 29. A limit of 4 SD takes 0.4 % of them.
    """
    rate = ensemble.sampling_rate
    if not 0 < cutoff < rate / 2:
        raise InputError(
            f"exclude_residual_outliers: cutoff must be between 0 and {rate / 2:g} Hz, got "
            f"{cutoff!r}"
        )
    sections = scipy.signal.butter(3, cutoff, fs=rate, output="sos")
    # Odd continuation by a second at most. The default would be too short for the slow filter.
    padding = min(round(rate), ensemble.torque.shape[1] - 1)
    slow = scipy.signal.sosfiltfilt(sections, ensemble.torque, axis=1, padlen=padding)
    return _exclude("residual", ensemble, slow[:, ensemble.core], limit)


def _exclude(step: str, ensemble: Ensemble, judged: Array, limit: float) -> Step:
    """Exclude realizations that leave mean ± limit · SD over realizations at any time."""
    positive.check(step, "limit", limit)
    mean, sd = judged.mean(axis=0), judged.std(axis=0, ddof=1)
    distance = np.abs(judged - mean)
    reached = np.divide(distance, sd, out=np.zeros_like(distance), where=sd > 0).max(axis=1)
    kept = reached <= limit
    return Step(ensemble.select(kept), kept, reached, limit, judged, mean, limit * sd)
