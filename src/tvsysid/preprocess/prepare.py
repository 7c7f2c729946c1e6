"""Align realizations to a target torque, exclude outliers, and run all steps of preparation."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.preprocess.faults import find_gaps
from tvsysid.preprocess.mean import subtract_mean
from tvsysid.preprocess.trials import Gap, decimate, segment, trim
from tvsysid.signals import Array, Ensemble, Recording

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@attrs.frozen(eq=False)
class Step:
    """Result of one step that excludes realizations.

    Parameters
    ----------
    ensemble
        Realizations that were kept.
    kept
        Whether each input realization was kept, shape (input realization,).
    reached, limit
        Largest deviation of each realization, and the largest allowed deviation: shifts in s for
        the alignment, otherwise distances from the mean in standard deviations.
    torque
        Torque that is compared with the mean, in N·m, shape (input realization, time).
    mean
        Mean of this torque over realizations, in N·m, shape (time,). For the alignment, the mean
        target.
    half_width
        Largest allowed distance from the mean, in N·m, shape (time,). None for the alignment.
    shifts
        Shift of each realization in s, positive where the torque came late.
    """

    ensemble: Ensemble
    kept: NDArray[np.bool_]
    reached: Array
    limit: float
    torque: Array
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
    identified stiffness, by 15 % for a virtual participant who follows the target perfectly. To
    exclude large shifts without shifting the others, identify
    ``preparation.recorded.select(preparation.kept)``.
    """
    rate = ensemble.sampling_rate
    core = ensemble.core
    goal = ensemble.signal(reference)
    reach, target = round(search * rate), goal[:, core]
    if ensemble.context < reach:
        raise InputError(
            f"align: shifts of up to {search:g} s need that much context, but the realizations "
            f"have {ensemble.context / rate:g} s; segment with more context"
        )
    errors = [
        np.sum((ensemble.torque[:, core.start + shift : core.stop + shift] - target) ** 2, axis=1)
        for shift in range(-reach, reach + 1)
    ]
    shifts = np.argmin(errors, axis=0) - reach
    inner = np.arange(reach, ensemble.angle.shape[1] - reach)
    rows = np.arange(len(ensemble))[:, None]
    index = inner + shifts[:, None]
    signals = ensemble.mapped(lambda values: values[rows, index])
    signals["channels"][reference] = goal[:, inner]
    aligned = attrs.evolve(
        ensemble,
        **signals,
        context=ensemble.context - reach,
        onsets=ensemble.onsets + shifts / rate,
    )
    reached = np.abs(shifts) / rate
    torque = aligned.torque[:, aligned.core]
    kept = reached <= max_shift
    if not kept.any():
        raise InputError(
            f"align: every realization needs a shift of more than {max_shift:g} s; do torque and "
            f"channel {reference!r} have the same sign and the same times?"
        )
    mean = target.mean(axis=0)
    return Step(aligned.select(kept), kept, reached, max_shift, torque, mean, shifts=shifts / rate)


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
    return _exclude(ensemble, harmonic, limit)


def exclude_residual_outliers(ensemble: Ensemble, cutoff: float = 5.0, limit: float = 3.0) -> Step:
    """Exclude realizations whose slow torque is an outlier at any time.

    The torque passes a third-order low-pass Butterworth filter forwards and backwards, without a
    delay. The filter begins and ends in the context.

    Parameters
    ----------
    ensemble
        At least two realizations, with or without their mean.
    cutoff
        -3 dB frequency of the filter's single pass in Hz, below half the sampling rate.
    limit
        Largest distance from the mean over realizations, in standard deviations.

    Notes
    -----
    Two seconds of torque below 5 Hz hold some 20 independent values. Therefore 10 % of Gaussian
    realizations reach 3 SD somewhere though none is an outlier: 30 of 300, where van de Ruit et al.
    2021 excluded 15 to 29. A limit of 4 SD excludes 0.4 % of them.
    """
    rate = ensemble.sampling_rate
    sections = scipy.signal.butter(3, cutoff, fs=rate, output="sos")
    # Odd continuation by a second at most. The default would be too short for the slow filter.
    padding = min(round(rate), ensemble.torque.shape[1] - 1)
    slow = scipy.signal.sosfiltfilt(sections, ensemble.torque, axis=1, padlen=padding)
    return _exclude(ensemble, (slow - slow.mean(axis=0))[:, ensemble.core], limit)


def _exclude(ensemble: Ensemble, torque: Array, limit: float) -> Step:
    """Exclude realizations that leave mean ± limit · SD over realizations at any time."""
    mean, sd = torque.mean(axis=0), torque.std(axis=0, ddof=1)
    reached = np.max(np.abs(torque - mean) / sd, axis=1)
    kept = reached <= limit
    return Step(ensemble.select(kept), kept, reached, limit, torque, mean, limit * sd)


@attrs.frozen(eq=False, repr=False)
class Preparation:
    """Ensemble that is ready for identification, and the steps that led to it.

    Parameters
    ----------
    ensemble
        Realizations that were kept, without their mean.
    recorded
        All realizations as they were cut, for comparison.
    steps
        Steps that exclude realizations, in order, by name: ``"alignment"``, ``"task component"``
        and ``"residual"``, if they were taken.
    """

    ensemble: Ensemble
    recorded: Ensemble
    steps: dict[str, Step]

    @property
    def table(self) -> pd.DataFrame:
        """Table with a row for each recorded realization.

        ``trial``; ``onset_s``, the time of its first sample within the trial before any shift;
        ``shift_s``, positive where the torque came late; ``excluded_by``, the name of a step, or
        empty where the realization was kept. For excluded realizations, ``reached`` is the value
        beyond the ``limit``, both in ``unit``.
        """
        import pandas as pd  # noqa: PLC0415  # heavy

        columns = {"trial": self.recorded.trials, "onset_s": self.recorded.onsets, "shift_s": 0.0}
        columns |= {"excluded_by": "", "reached": np.nan, "limit": np.nan, "unit": ""}
        table = pd.DataFrame(columns).rename_axis("realization")
        rows = table.index
        for name, step in self.steps.items():
            table.loc[rows, "shift_s"] += step.shifts
            out, rows = rows[~step.kept], rows[step.kept]
            table.loc[out, "reached"] = step.reached[~step.kept]
            unit = "s" if name == "alignment" else "SD"
            table.loc[out, ["excluded_by", "limit", "unit"]] = name, step.limit, unit
        return table

    @property
    def kept(self) -> NDArray[np.bool_]:
        """Whether each recorded realization was kept, shape (realization,)."""
        return np.asarray(self.table.excluded_by == "")

    def plot(self, title: str = "") -> Figure:
        """Draw the steps of the preparation."""
        from tvsysid.figures import plot  # noqa: PLC0415  # figures stand above

        return plot(self, title)

    def __repr__(self) -> str:
        counts = (f"{np.sum(~step.kept)} by {name}" for name, step in self.steps.items())
        return (
            f"Preparation({self.ensemble!r}; {len(self.ensemble)} of {len(self.recorded)} "
            f"realizations kept; excluded: {', '.join(counts) or 'none'})"
        )


def prepare_experiment(
    recording: Recording,
    *,
    reference: str | None = "target",
    rate: float = 128.0,
    ends: float = 5.0,
    period: float = 2.0,
    context: float = 0.5,
    search: float = 0.5,
    max_shift: float = 0.25,
    task_limit: float | None = 3.0,
    cutoff: float = 5.0,
    residual_limit: float | None = 3.0,
    channels: Iterable[str] = (),
    gaps: Iterable[Gap] | None = None,
) -> Preparation:
    """Decimate, trim, segment, align, exclude outliers, and subtract the mean.

    All channels pass every step. Realizations with gaps (:func:`find_gaps`) are left out.

    Parameters
    ----------
    recording
        Trials in which one movement or torque was repeated, with the target as a channel.
    reference
        Name of the channel with the target torque in N·m. With None, nothing is aligned.
    rate
        Sampling rate to decimate to, in Hz.
    ends
        Seconds removed at both ends of each trial. The first and last realization of a trial take
        their context from these seconds (``context + search``, or ``context`` if nothing is
        aligned). They are left out if ``ends`` is shorter.
    period
        Duration of a realization in s: one cycle of the task.
    context
        Seconds of context on either side of each prepared realization.
    search, max_shift
        See :func:`align`.
    task_limit, cutoff, residual_limit
        See :func:`exclude_task_outliers` and :func:`exclude_residual_outliers`. A limit of None
        leaves that step out.
    channels
        Channels whose mean is subtracted too; see :func:`subtract_mean`.
    gaps
        Gaps found before mains hum was subtracted, which hides them. None finds them.

    References
    ----------
    van de Ruit et al. 2021, sections 4.1.4 and 4.1.5; the defaults are theirs. They removed the
    ends before they cut the trials into realizations. Here, a part of the ends stays as context, so
    that no realization is lost.

    Examples
    --------
    >>> import tvsysid as tv
    >>> simulation = tv.simulate.Participant(1).simulate()
    >>> tv.preprocess.prepare_experiment(simulation.recording).ensemble
    Ensemble(... realizations of 2 s at 128 Hz, context 0.5 s; ...)
    """
    margin = context if reference is None else context + search
    trimmed = trim(decimate(recording, rate), ends, min(margin, ends))
    gaps = find_gaps(recording) if gaps is None else gaps
    kept = recorded = segment(trimmed, period, margin, gaps)
    steps = {}
    if reference is not None:
        steps["alignment"] = align(kept, reference, search, max_shift)
        kept = steps["alignment"].ensemble
    if task_limit is not None:
        steps["task component"] = exclude_task_outliers(kept, task_limit)
        kept = steps["task component"].ensemble
    if residual_limit is not None:
        steps["residual"] = exclude_residual_outliers(kept, cutoff, residual_limit)
        kept = steps["residual"].ensemble
    return Preparation(subtract_mean(kept, channels), recorded, steps)
