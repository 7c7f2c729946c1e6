"""What became of each realization, step by step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.estimates import frozen
from tvsysid.signals import Array, Ensemble

if TYPE_CHECKING:
    import pandas as pd


@attrs.frozen(eq=False, repr=False)
class Account:
    """What became of each realization that a step, or a chain of steps, was given.

    All of shape (realization,).

    Accounts add up: ``first + second``, where the second step was given what the first one kept.

    Its trial, and the time of its first sample within the trial in s, before any shift; by how
    much it was moved in s, positive where the torque came late; the step that excluded it, empty
    where it was kept; how far out it was in that step, and could have been, NaN where it was
    kept, in ``units``: ``"s"`` for shifts, ``"SD"`` for deviations from the mean.
    """

    trials: NDArray[np.int64]
    onsets: Array
    shifts: Array
    excluded_by: NDArray[np.str_]
    reached: Array
    limits: Array
    units: NDArray[np.str_]

    def __attrs_post_init__(self) -> None:
        for field in attrs.fields(type(self)):
            object.__setattr__(self, field.name, frozen(getattr(self, field.name)))

    @classmethod
    def of(cls, ensemble: Ensemble, step: str, reached: Array, limit: float, unit: str) -> Account:
        """Account of a step that excludes realizations whose ``reached``, shape (realization,), is over the limit."""
        assert ensemble.trials is not None
        assert ensemble.onsets is not None
        out = reached > limit
        return cls(
            trials=ensemble.trials.copy(),
            onsets=ensemble.onsets.copy(),
            shifts=np.zeros(len(ensemble)),
            excluded_by=np.where(out, step, ""),
            reached=np.where(out, reached, np.nan),
            limits=np.where(out, limit, np.nan),
            units=np.where(out, unit, ""),
        )

    def __len__(self) -> int:
        return len(self.trials)

    def __add__(self, later: Account) -> Account:
        kept = self.kept
        if len(later) != np.count_nonzero(kept):
            raise InputError(
                f"Account: the first step kept {np.count_nonzero(kept)} realizations, but the "
                "second was given "
                f"{len(later)}; add accounts in the order of the steps"
            )
        changes = {}
        for name in ("excluded_by", "reached", "limits", "units"):
            before, after = getattr(self, name), getattr(later, name)
            changes[name] = before.astype(np.result_type(before, after))
            changes[name][kept] = after
        shifts = self.shifts.copy()
        shifts[kept] += later.shifts
        return Account(self.trials, self.onsets, shifts, **changes)

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} by {step}" for step, count in self.counts.items())
        return (
            f"Account({np.count_nonzero(self.kept)} of {len(self)} realizations kept; "
            f"excluded: {counts or 'none'})"
        )

    @property
    def kept(self) -> NDArray[np.bool_]:
        """Which realizations were kept, shape (realization,)."""
        return np.asarray(self.excluded_by == "")

    @property
    def counts(self) -> dict[str, int]:
        """How many realizations each step excluded; steps that excluded none are not listed."""
        steps, counts = np.unique(self.excluded_by[~self.kept], return_counts=True)
        return {str(step): int(count) for step, count in zip(steps, counts, strict=True)}

    @property
    def table(self) -> pd.DataFrame:
        """One row for each realization: trial, onset, shift, and for those excluded the step and how far out."""
        import pandas as pd  # noqa: PLC0415  # heavy

        return pd.DataFrame(
            {
                "trial": self.trials,
                "onset_s": self.onsets,
                "shift_s": self.shifts,
                "excluded_by": self.excluded_by,
                "reached": self.reached,
                "limit": self.limits,
                "unit": self.units,
            },
            index=pd.RangeIndex(len(self), name="realization"),
        )


@attrs.frozen(eq=False)
class Step:
    """One step that excludes realizations: what it judged, by which limits, what it left.

    Parameters
    ----------
    ensemble
        The realizations that were kept.
    account
        What became of each realization.
    judged
        The torque that was judged in N·m, shape (realization given, time), context not counted.
    mean
        Its mean over realizations in N·m, shape (time,); the reference torque for the alignment.
    half_width
        Distance from the mean in N·m beyond which a realization was excluded, shape (time,); None
        for the alignment, which judges the shift.
    """

    ensemble: Ensemble
    account: Account
    judged: Array
    mean: Array
    half_width: Array | None = None
