"""From a recording of repeated behaviour to the ensemble that is identified: the paper's whole sequence."""

from __future__ import annotations

from collections.abc import Iterable

import attrs
import numpy as np

from tvsysid.preprocess.account import Account, Step
from tvsysid.preprocess.exclude import align, exclude_residual_outliers, exclude_task_outliers
from tvsysid.preprocess.gaps import find_gaps
from tvsysid.preprocess.segment import decimate, segment, subtract_mean, trim
from tvsysid.showing import Shown
from tvsysid.signals import Ensemble, Recording


@attrs.frozen(eq=False, repr=False)
class Preparation(Shown):
    """An ensemble ready for identification, and how it came about.

    ``ensemble`` holds the realizations that were kept, their mean subtracted, ``recorded`` all
    as they were cut, for comparison. The three steps that exclude follow in order; None for one
    that was not asked for.
    """

    ensemble: Ensemble
    recorded: Ensemble
    alignment: Step | None
    task: Step | None
    residual: Step | None

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps that were taken, in order."""
        return tuple(
            step for step in (self.alignment, self.task, self.residual) if step is not None
        )

    @property
    def account(self) -> Account:
        """What became of each realization that was cut."""
        nothing_excluded = Account.of(self.recorded, "", np.zeros(len(self.recorded)), np.inf, "")
        return sum((step.account for step in self.steps), start=nothing_excluded)

    def __repr__(self) -> str:
        return f"Preparation({self.ensemble!r}; {self.account!r})"


def prepare(
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
) -> Preparation:
    """Decimate, trim, cut, align, exclude what is unlike the rest, subtract the mean.

    All channels pass every step.

    Realizations with gaps (:func:`find_gaps`) are left out.

    Parameters
    ----------
    recording
        Trials in which one behaviour was repeated, with the reference as a channel.
    reference
        Name of the channel with the torque to be followed, in N·m. None if there was none: then
        nothing is aligned.
    rate
        Sampling rate to decimate to, in Hz.
    ends
        Seconds taken off both ends of each trial. The first and last realization of a trial take
        ``context + search`` (``context`` alone if nothing is aligned) from them, and are left out
        where they last shorter.
    period
        Duration of a realization in s: one cycle of the task.
    context
        Seconds of the record that each realization has on either side in the end.
    search, max_shift
        See :func:`align`.
    task_limit, cutoff, residual_limit
        See :func:`exclude_task_outliers` and :func:`exclude_residual_outliers`; a limit of None
        leaves that step out.
    channels
        Channels that lose their mean with angle and torque; see :func:`subtract_mean`.

    References
    ----------
    van de Ruit et al. 2021, sections 4.1.4 and 4.1.5; the defaults are theirs. They took off the ends before they cut;
    here a margin of them stays as context, so that no realization is lost or continued by invention.

    Examples
    --------
    >>> import tvsysid as tv
    >>> simulation = tv.simulate.Participant(1).simulate()
    >>> tv.preprocess.prepare(simulation.recording).ensemble
    Ensemble(... realizations of 2 s at 128 Hz, context 0.5 s; ...)
    """
    margin = context if reference is None else context + search
    lowered = decimate(recording, rate)
    trimmed = trim(lowered, ends, min(margin, ends))
    kept = recorded = segment(trimmed, period, margin, find_gaps(recording))
    alignment = task = residual = None
    if reference is not None:
        alignment = align(kept, reference, search, max_shift)
        kept = alignment.ensemble
    if task_limit is not None:
        task = exclude_task_outliers(kept, task_limit)
        kept = task.ensemble
    channels = tuple(channels)
    kept = subtract_mean(kept, channels)
    if residual_limit is not None:
        residual = exclude_residual_outliers(kept, cutoff, residual_limit)
        kept = subtract_mean(residual.ensemble, channels)
    return Preparation(kept, recorded, alignment, task, residual)
