"""Prepare a recording for identification by the whole sequence of the paper."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.preprocess.decimate import decimate
from tvsysid.preprocess.exclude import (
    Step,
    align,
    exclude_residual_outliers,
    exclude_task_outliers,
)
from tvsysid.preprocess.gaps import find_gaps
from tvsysid.preprocess.mean import subtract_mean
from tvsysid.preprocess.segment import segment, trim
from tvsysid.signals import Ensemble, Recording

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


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
        """One row for each recorded realization.

        ``trial``; ``onset_s``, the time of its first sample within the trial before any shift;
        ``shift_s``, positive where the torque came late; ``excluded_by``, the name of a step, or
        empty where the realization was kept. For those excluded, ``reached`` is the value beyond
        the ``limit``, both in ``unit``.
        """
        import pandas as pd  # noqa: PLC0415  # heavy

        table = pd.DataFrame(
            {
                "trial": self.recorded.trials,
                "onset_s": self.recorded.onsets,
                "shift_s": 0.0,
                "excluded_by": "",
                "reached": np.nan,
                "limit": np.nan,
                "unit": "",
            }
        ).rename_axis("realization")
        rows = table.index.to_numpy()
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
    """Decimate, trim, segment, align, exclude outliers, and subtract the mean.

    All channels pass every step. Realizations with gaps (:func:`find_gaps`) are left out.

    Parameters
    ----------
    recording
        Trials in which one behaviour was repeated, with the target as a channel.
    reference
        Name of the channel with the target torque in N·m. None if there was none: then nothing is
        aligned.
    rate
        Sampling rate to decimate to, in Hz.
    ends
        Seconds taken off both ends of each trial. The first and last realization of a trial take
        their context from them (``context + search``, or ``context`` if nothing is aligned), and
        are left out if the ends are shorter.
    period
        Duration of a realization in s: one cycle of the task.
    context
        Seconds of the record that each realization has on either side in the end.
    search, max_shift
        See :func:`align`.
    task_limit, cutoff, residual_limit
        See :func:`exclude_task_outliers` and :func:`exclude_residual_outliers`. A limit of None
        leaves that step out.
    channels
        Channels that lose their mean with angle and torque; see :func:`subtract_mean`.

    References
    ----------
    van de Ruit et al. 2021, sections 4.1.4 and 4.1.5; the defaults are theirs. They took off the
    ends before they cut. Here a margin of them stays as context, so that no realization is lost.

    Examples
    --------
    >>> import tvsysid as tv
    >>> simulation = tv.simulate.Participant(1).simulate()
    >>> tv.preprocess.prepare(simulation.recording).ensemble
    Ensemble(... realizations of 2 s at 128 Hz, context 0.5 s; ...)
    """
    margin = context if reference is None else context + search
    trimmed = trim(decimate(recording, rate), ends, min(margin, ends))
    kept = recorded = segment(trimmed, period, margin, find_gaps(recording))
    steps = {}
    if reference is not None:
        steps["alignment"] = align(kept, reference, search, max_shift)
        kept = steps["alignment"].ensemble
    if task_limit is not None:
        steps["task component"] = exclude_task_outliers(kept, task_limit)
        kept = steps["task component"].ensemble
    channels = tuple(channels)
    kept = subtract_mean(kept, channels)
    if residual_limit is not None:
        steps["residual"] = exclude_residual_outliers(kept, cutoff, residual_limit)
        kept = subtract_mean(steps["residual"].ensemble, channels)
    return Preparation(kept, recorded, steps)
