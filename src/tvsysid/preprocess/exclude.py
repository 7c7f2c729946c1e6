"""Exclude realizations that are unlike the others."""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import butter, sosfiltfilt

from tvsysid.errors import InputError
from tvsysid.preprocess.account import Account, Step
from tvsysid.signals import Array, Ensemble

ORDER = 3


def exclude_task_outliers(ensemble: Ensemble, limit: float = 3.0) -> Step:
    """Exclude realizations whose torque at the task's frequency leaves the ensemble's mean and spread at any time.

    The task repeats once in a realization: its component is the first harmonic of the realization, all others set to
    zero.

    Parameters
    ----------
    ensemble
        Aligned; the voluntary torque still in it.
    limit
        Largest distance from the mean over realizations, in standard deviations, at any time.

    Raises
    ------
    InputError
        If the limit is not positive, or there are fewer than two realizations, or none is left.

    Notes
    -----
    Mean and standard deviation are those of all realizations given, and are not computed again without the outliers.
    Even if all is Gaussian some 1 in 90 realizations (exp(-4.5)) reaches 3 SD, because the component has two degrees of
    freedom.
    """
    return _exclude("task component", ensemble, task_component(ensemble.torque[:, ensemble.core]), limit)


def exclude_residual_outliers(ensemble: Ensemble, cutoff: float = 5.0, limit: float = 3.0) -> Step:
    """Exclude realizations whose slow torque leaves the ensemble's mean and spread at any time.

    The torque passes a third-order low-pass Butterworth filter forwards and backwards, which delays nothing; it begins
    and ends in the context.

    Parameters
    ----------
    ensemble
        Deviations from the mean over realizations.
    cutoff
        -3 dB frequency of the filter's single pass in Hz.
    limit
        Largest distance from the mean over realizations, in standard deviations, at any time.

    Raises
    ------
    InputError
        As of :func:`exclude_task_outliers`, and for a cut-off that is not below half the sampling rate.

    Notes
    -----
    Two seconds of torque below 5 Hz hold some 20 independent values, so that 10 % of Gaussian realizations reach 3 SD
    somewhere though none is unlike the others: 30 of 300, where van de Ruit et al. 2021 excluded 15 to 29. A limit of
    4 SD takes 0.4 % of them.
    """
    rate = ensemble.sampling_rate
    if not 0 < cutoff < rate / 2:
        raise InputError(f"exclude_residual_outliers: cutoff must be between 0 and {rate / 2:g} Hz, got {cutoff!r}")
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
        raise InputError(f"{step}: limit must be a positive number of standard deviations, got {limit!r}")
    if len(judged) < 2:
        raise InputError(f"{step}: expected at least two realizations to tell which are unlike the others, got one")
    mean, sd = judged.mean(axis=0), judged.std(axis=0, ddof=1)
    distance = np.abs(judged - mean)
    reached = np.divide(distance, sd, out=np.zeros_like(distance), where=sd > 0).max(axis=1)
    account = Account.of(ensemble, step, reached, limit, "SD")
    if not account.kept.any():
        raise InputError(f"{step}: every realization leaves the mean by {limit:g} SD somewhere; give a higher limit")
    return Step(ensemble.select(account.kept), account, judged, mean, limit * sd)
