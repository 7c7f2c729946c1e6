"""Recordings and ensembles: checked once when they are made, unchangeable after, SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.checked import Frozen, checked_array, checked_rate
from tvsysid.errors import InputError
from tvsysid.numerics import Array as Array  # noqa: PLC0414  # most rooms take both from here
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.showing import Shown

if TYPE_CHECKING:
    import xarray as xr

SMALLEST, LARGEST = (
    1e-30,
    1e30,
)  # of an ensemble's largest angle and torque; squares of squares end beyond


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


class _Signals(Shown, Frozen):
    """What recordings and ensembles have in common."""

    angle: Array
    torque: Array
    sampling_rate: float
    channels: Mapping[str, Array]
    recorded_angle: Array | None

    def _check(self, axes: tuple[str, ...]) -> None:
        """Replace what was given by what was checked."""
        object.__setattr__(self, "sampling_rate", checked_rate(self.sampling_rate))
        for name, unit, fault in (
            ("angle", "rad", "a joint that is not moved"),
            ("torque", "N·m", "a torque that does not answer"),
        ):
            values = checked_array(name, getattr(self, name), axes)
            object.__setattr__(self, name, values)
            if values.shape != np.shape(self.angle):
                raise InputError(
                    f"angle and torque must have the same shape, got {self.angle.shape} and "
                    f"{values.shape}; "
                    "cut them to the samples that both have"
                )
            if values.min() == values.max():
                raise InputError(
                    f"{name}: all {values.size} values are {values.flat[0]:g} {unit}; {fault} "
                    "cannot be "
                    "identified. Is this the right channel?"
                )
        channels = {
            name: checked_array(f"channel {name!r}", each, axes)
            for name, each in self.channels.items()
        }
        for name, values in channels.items():
            if values.shape != self.angle.shape:
                raise InputError(
                    f"channel {name!r}: expected the angle's shape {self.angle.shape}, got "
                    f"{values.shape}"
                )
        object.__setattr__(self, "channels", channels)
        if self.recorded_angle is not None:
            recorded = checked_array("recorded_angle", self.recorded_angle, (*axes, "sample"))
            if recorded.shape[:-1] != self.angle.shape:
                expected = (
                    f"({', '.join(map(str, self.angle.shape))}, samples recorded for each "
                    "of the angle's)"
                )
                raise InputError(
                    f"recorded_angle: expected the shape {expected}, got {recorded.shape}; cut "
                    "both, or give None"
                )
            object.__setattr__(self, "recorded_angle", recorded)

    def __len__(self) -> int:
        return len(self.angle)

    @property
    def angle_as_recorded(self) -> Array:
        """``recorded_angle``.

        Where no rate was lowered, the angle itself, each of its samples alone on a last axis.
        """
        return self.angle[..., None] if self.recorded_angle is None else self.recorded_angle

    def signal(self, name: str) -> Array:
        """``"angle"``, ``"torque"`` or a channel by its name, of the angle's shape: of an ensemble, with its context.

        Raises
        ------
        InputError
            For any other name.
        """
        found = {"angle": self.angle, "torque": self.torque, **self.channels}
        if name not in found:
            there = ", ".join(map(repr, found))
            raise InputError(
                f"signal: there is no {name!r}; the signals are {there}; read it as a channel "
                f"(--channel {name}=…)"
            )
        return found[name]


@attrs.frozen(eq=False, repr=False)
class Recording(_Signals):
    """Angle and torque of a joint against time: one continuous record, or several trials one after the other.

    Parameters
    ----------
    angle, torque
        In rad and N·m, shape (time,); the torque is positive where it resists a positive angle.
    sampling_rate
        In Hz.
    start
        Time of the first sample (of each trial) in s.
    channels
        Further signals by name, each of shape (time,).
    trial_starts
        Index of the first sample of each trial; nothing is filtered or cut across these.
    origin
        Where time 0 lies within a trial as it was recorded, in s, if the ends were taken off and
        time begins anew.
    delay_removed
        Seconds by which the torque was late, which were corrected
        (:func:`tvsysid.preprocess.align_channels`).
    recorded_angle
        The angle before :func:`tvsysid.preprocess.decimate` lowered its rate, in rad, shape (time,
        sample): the samples that were recorded from each of the angle's up to the next. A stretch
        is rectified at this rate.

    Raises
    ------
    InputError
        For signals that are not finite numbers of one common length, an angle that does not vary,
        or a sampling rate that is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> angle = np.sin(np.arange(1000) / 50)
    >>> Recording(angle, 80 * angle, sampling_rate=100)
    Recording(10 s at 100 Hz; angle RMS 0.7 rad, torque RMS 56 N·m)
    """

    angle: Array
    torque: Array
    sampling_rate: float
    start: float = 0.0
    channels: Mapping[str, Array] = attrs.field(factory=dict)
    trial_starts: tuple[int, ...] = (0,)
    origin: float = 0.0
    delay_removed: float = 0.0
    recorded_angle: Array | None = None

    def __attrs_post_init__(self) -> None:
        self._check(("time",))
        if not (isinstance(self.start, (int, float, np.number)) and math.isfinite(self.start)):
            raise InputError(
                f"start: expected the time of the first sample in seconds, got {self.start!r}"
            )
        starts = self.trial_starts
        if not all(isinstance(first, (int, np.integer)) for first in starts):
            raise InputError(f"trial_starts: expected whole numbers, got {starts!r}")
        if (
            not starts
            or starts[0] != 0
            or any(b <= a for a, b in zip(starts, (*starts[1:], len(self)), strict=True))
        ):
            raise InputError(
                f"trial_starts: expected increasing sample indices from 0 to below {len(self)}, "
                f"got {starts!r}"
            )

    def __repr__(self) -> str:
        trials = f" in {len(self.trial_starts)} trials" if len(self.trial_starts) > 1 else ""
        return (
            f"Recording({self.duration:g} s{trials} at {self.sampling_rate:g} Hz; "
            f"angle RMS {_rms(self.angle):.3g} rad, torque RMS {_rms(self.torque):.3g} N·m)"
        )

    @property
    def duration(self) -> float:
        """Seconds recorded, all trials together."""
        return len(self) / self.sampling_rate

    @property
    def trials(self) -> tuple[slice, ...]:
        """Samples of each trial."""
        ends = (*self.trial_starts[1:], len(self))
        return tuple(slice(first, end) for first, end in zip(self.trial_starts, ends, strict=True))

    @property
    def time(self) -> Array:
        """Time of each sample in s, shape (time,); begins anew with each trial."""
        counts = [np.arange(trial.stop - trial.start) for trial in self.trials]
        return self.start + np.concatenate(counts) / self.sampling_rate


@attrs.frozen(eq=False, repr=False)
class Ensemble(_Signals):
    """Realizations of one repeated behaviour, aligned in time.

    Parameters
    ----------
    angle, torque
        In rad and N·m, shape (realization, context + time + context).
    sampling_rate
        In Hz.
    context
        Samples on either side of each realization that were recorded there, so that lags and
        windows at its edges use measured data. Without them, what cannot be estimated is NaN.
    onsets
        Time in s of each realization's first sample (context not counted), shape (realization,).
        Realizations of one trial that follow each other without a gap are joined by methods that
        need a continuous record. Default: none follows another.
    trials
        Number of the trial that each realization comes from, shape (realization,).
    channels
        Further signals by name, each of the angle's shape.
    left_out
        How many realizations were not taken up when the record was cut, for want of context.
    mean_subtracted
        Whether the mean over realizations was subtracted
        (:func:`tvsysid.preprocess.subtract_mean`): the noise of R realizations then counts as that
        of R - 1.
    origin, delay_removed, recorded_angle
        Those of the recording that it was cut from; the angle of shape (realization, context + time
        + context, sample), from which no mean is subtracted.

    Raises
    ------
    InputError
        For signals that are not finite numbers of one common shape, an angle that does not vary,
        values up to less than 1e-30 or more than 1e30, a sampling rate that is not positive, or a
        context that leaves no sample.

    Examples
    --------
    >>> import numpy as np
    >>> angle = np.random.default_rng(0).normal(size=(50, 200))
    >>> Ensemble(angle, 80 * angle, sampling_rate=100)
    Ensemble(50 realizations of 2 s at 100 Hz, context 0 s; angle RMS 0.998 rad, torque RMS 79.8
    N·m)
    """

    angle: Array
    torque: Array
    sampling_rate: float
    context: int = 0
    onsets: Array | None = None
    trials: NDArray[np.int64] | None = None
    channels: Mapping[str, Array] = attrs.field(factory=dict)
    left_out: int = 0
    mean_subtracted: bool = False
    origin: float = 0.0
    delay_removed: float = 0.0
    recorded_angle: Array | None = None

    def __attrs_post_init__(self) -> None:
        axes = ("realization", "time")
        self._check(axes)
        for name, unit in (("angle", "rad"), ("torque", "N·m")):
            largest = max(abs(float(extreme(getattr(self, name)))) for extreme in (np.min, np.max))
            if not SMALLEST <= largest <= LARGEST:
                expected = (
                    f"{name}: expected values in {unit}, the largest from {SMALLEST:g} to "
                    f"{LARGEST:g}"
                )
                raise InputError(
                    f"{expected}, got values up to {largest:.2g}; is the file damaged, or the "
                    "unit wrong?"
                )
        whole = isinstance(self.context, (int, np.integer)) and not isinstance(self.context, bool)
        if not whole or not 0 <= 2 * self.context < self.angle.shape[1]:
            raise InputError(
                "context: expected a whole number of samples from 0 to "
                f"{(self.angle.shape[1] - 1) // 2} (half of the "
                f"{self.angle.shape[1]} samples given), got {self.context!r}"
            )
        object.__setattr__(self, "context", int(self.context))
        count = (len(self.angle),)
        separate = self.onsets is None and self.trials is None
        onsets = (
            np.zeros(count)
            if self.onsets is None
            else checked_array("onsets", self.onsets, axes[:1])
        )
        trials = np.arange(count[0]) if separate else np.zeros(count, dtype=np.int64)
        if self.trials is not None:
            trials = np.array(self.trials)
            if trials.dtype.kind not in "iu":
                raise InputError(
                    f"trials: expected whole numbers, got values of type {trials.dtype}"
                )
        if onsets.shape != count or trials.shape != count:
            raise InputError(
                f"onsets and trials: expected one for each of the {count[0]} realizations, "
                f"got shapes {onsets.shape} and {trials.shape}"
            )
        trials = trials.astype(np.int64)
        for values in (onsets, trials):
            values.flags.writeable = False
        object.__setattr__(self, "onsets", onsets)
        object.__setattr__(self, "trials", trials)

    def __repr__(self) -> str:
        left_out = (
            f", {self.left_out} left out: too near the ends for the context"
            if self.left_out
            else ""
        )
        plural = "s" * (len(self) != 1)
        return (
            f"Ensemble({len(self)} realization{plural} of {self.duration:g} s at "
            f"{self.sampling_rate:g} Hz, "
            f"context {self.context / self.sampling_rate:g} s{left_out}; angle RMS "
            f"{_rms(self.angle):.3g} rad, "
            f"torque RMS {_rms(self.torque):.3g} N·m)"
        )

    def derivatives(self, order: int = 2) -> Array:
        """Angle and its band-limited derivatives up to the order 0, 1 or 2, in rad, rad/s and rad/s².

        Of shape (order + 1, realization, time), context not counted; NaN where the filters of
        :mod:`tvsysid.numerics.differentiation` reach beyond the context.
        """
        if order not in (0, 1, 2):
            raise InputError(f"derivatives: order must be 0, 1 or 2, got {order!r}")
        reach = HALF_WIDTH if order else 0
        missing = max(0, reach - self.context)
        out = np.full((order + 1, len(self), self.samples), np.nan)
        inner = slice(missing, self.samples - missing)
        if inner.stop > inner.start:
            first = self.context + missing - reach
            angle = self.angle[:, first : self.angle.shape[1] - first]
            out[:, :, inner] = (
                differentiate(angle, self.sampling_rate)[: order + 1] if order else angle
            )
        return out

    @property
    def samples(self) -> int:
        """Samples of one realization, context not counted."""
        return int(self.angle.shape[1] - 2 * self.context)

    @property
    def duration(self) -> float:
        """Seconds of one realization, context not counted."""
        return self.samples / self.sampling_rate

    @property
    def time(self) -> Array:
        """Time within a realization in s, shape (time,), context not counted."""
        return np.arange(self.samples) / self.sampling_rate

    @property
    def core(self) -> slice:
        """Samples of a realization within its context: ``ensemble.torque[:, ensemble.core]``."""
        return slice(self.context, self.context + self.samples)

    @property
    def runs(self) -> tuple[NDArray[np.int64], ...]:
        """Indices of realizations that follow each other without a gap, one array for each unbroken run."""
        assert self.onsets is not None
        assert self.trials is not None
        order = np.lexsort((self.onsets, self.trials))
        onsets, trials = self.onsets[order], self.trials[order]
        tolerance = 0.5 / self.sampling_rate
        broken = (np.abs(np.diff(onsets) - self.duration) > tolerance) | (np.diff(trials) != 0)
        return tuple(np.split(order, np.flatnonzero(broken) + 1))

    def select(self, realizations: ArrayLike) -> Ensemble:
        """Ensemble of the realizations with these indices, in this order, or of those that a boolean mask marks."""
        index = np.asarray(realizations)
        if index.ndim != 1 or not index.size:
            raise InputError(
                f"select: expected the indices of some realizations, got shape {index.shape}"
            )
        if index.dtype.kind == "b" and len(index) != len(self):
            raise InputError(
                f"select: expected a mask of {len(self)} realizations, got {len(index)}"
            )
        if index.dtype.kind not in "biu":
            raise InputError(
                "select: expected whole numbers or a boolean mask, got values of type "
                f"{index.dtype}"
            )
        beyond = index[(index < -len(self)) | (index >= len(self))]
        if index.dtype.kind != "b" and beyond.size:
            raise InputError(
                f"select: expected indices from {-len(self)} to below {len(self)}, got {beyond[0]}"
            )
        names = ["angle", "torque", "onsets", "trials"] + ["recorded_angle"] * (
            self.recorded_angle is not None
        )
        changes: dict[str, Any] = {name: getattr(self, name)[index] for name in names}
        return attrs.evolve(
            self,
            **changes,
            channels={name: values[index] for name, values in self.channels.items()},
        )

    def to_xarray(self) -> xr.Dataset:
        """Return the signals as an xarray.Dataset with dimensions realization and time, units as attributes."""
        import xarray as xr  # noqa: PLC0415  # heavy

        time = (np.arange(self.angle.shape[1]) - self.context) / self.sampling_rate
        dims = ("realization", "time")
        about = ("sampling_rate", "context", "left_out", "origin", "delay_removed")
        recorded = {}
        if self.recorded_angle is not None:
            recorded = {
                "recorded_angle": ((*dims, "sample"), self.recorded_angle, {"units": "rad"})
            }
        return xr.Dataset(
            {
                "angle": (dims, self.angle, {"units": "rad"}),
                "torque": (dims, self.torque, {"units": "N m"}),
                **{name: (dims, values) for name, values in self.channels.items()},
                **recorded,
            },
            coords={
                "time": ("time", time, {"units": "s"}),
                "onset": ("realization", self.onsets, {"units": "s"}),
                "trial": ("realization", self.trials),
            },
            # NetCDF has no truth values.
            attrs={name: getattr(self, name) for name in about}
            | {"mean_subtracted": int(self.mean_subtracted)},
        )
