"""Recordings and ensembles: read-only signals in SI units, checked when they are made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.arrays import check_finite, read_only, to_array, to_arrays
from tvsysid.errors import InputError
from tvsysid.numerics import Array as Array  # noqa: PLC0414  # most modules import it from here
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.validators import finite, frequency, is_whole, to_float

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Peaks of angle and torque outside these limits would overflow or vanish in fourth powers.
MIN_PEAK, MAX_PEAK = 1e-30, 1e30


def _check_signal(signals: Signals, field: attrs.Attribute[Any], values: Array) -> None:
    _check_shape(field.name, values, signals)
    low, high = float(values.min()), float(values.max())
    if low == high:
        raise InputError(
            f"{field.name}: all {values.size} values are {low:g}, so impedance cannot be "
            "identified. Is this the right channel?"
        )
    if not MIN_PEAK <= max(-low, high) <= MAX_PEAK:
        raise InputError(
            f"{field.name}: expected a peak from {MIN_PEAK:g} to {MAX_PEAK:g}, got values from "
            f"{low:.2g} to {high:.2g}. Is the file damaged, or the unit wrong?"
        )


def _check_channels(signals: Signals, field: object, channels: Mapping[str, Array]) -> None:
    for name, values in channels.items():
        _check_shape(f"channel {name!r}", values, signals)


def _check_recorded_angle(signals: Signals, field: object, values: Array | None) -> None:
    if values is not None:
        _check_shape("recorded_angle", values, signals, "sample")


def _check_shape(name: str, values: Array, signals: Signals, *further_axes: str) -> None:
    check_finite(name, values, (*signals.AXES, *further_axes))
    expected = signals.angle.shape
    if values.shape[: len(expected)] != expected:
        raise InputError(
            f"{name}: expected the angle's shape {expected}, got {values.shape}; cut both to the "
            "same samples"
        )


@attrs.frozen(eq=False, repr=False)
class Signals:
    """Fields and methods that recordings and ensembles share."""

    AXES: ClassVar[tuple[str, ...]]

    angle: Array = attrs.field(converter=to_array, validator=_check_signal)
    torque: Array = attrs.field(converter=to_array, validator=_check_signal)
    sampling_rate: float = attrs.field(converter=to_float, validator=frequency)
    channels: Mapping[str, Array] = attrs.field(
        factory=dict, kw_only=True, converter=to_arrays, validator=_check_channels
    )
    origin: float = attrs.field(default=0.0, kw_only=True)
    delay_removed: float = attrs.field(default=0.0, kw_only=True)
    recorded_angle: Array | None = attrs.field(
        default=None,
        kw_only=True,
        converter=attrs.converters.optional(to_array),
        validator=_check_recorded_angle,
    )

    def __len__(self) -> int:
        return len(self.angle)

    @property
    def angle_as_recorded(self) -> Array:
        """Angle at the recorded rate.

        The last axis holds the recorded samples per sample of the angle, one if it was not
        decimated.
        """
        return self.angle[..., None] if self.recorded_angle is None else self.recorded_angle

    def signal(self, name: str) -> Array:
        """Return ``"angle"``, ``"torque"`` or a channel by its name, with the angle's shape.

        Raises
        ------
        InputError
            If no signal has this name.
        """
        signals = {"angle": self.angle, "torque": self.torque, **self.channels}
        if name not in signals:
            raise InputError(
                f"signal: there is no {name!r}; the signals are {', '.join(map(repr, signals))}; "
                f"read it as a channel (--channel {name}=…)"
            )
        return signals[name]

    def mapped(self, change: Callable[[Array], Array]) -> dict[str, Any]:
        """Return the result of ``change`` for each signal, by field name."""
        recorded = self.recorded_angle
        return {
            "angle": change(self.angle),
            "torque": change(self.torque),
            "channels": {name: change(values) for name, values in self.channels.items()},
            "recorded_angle": None if recorded is None else change(recorded),
        }

    def plot(self, title: str = "") -> Figure:
        """Draw the signals."""
        from tvsysid.figures import plot  # noqa: PLC0415  # figures stand above signals

        return plot(self, title)

    def _magnitudes(self) -> str:
        angle, torque = (np.sqrt(np.mean(each**2)) for each in (self.angle, self.torque))
        return f"angle RMS {angle:.3g} rad, torque RMS {torque:.3g} N·m"


def _check_trial_starts(
    recording: Recording, field: attrs.Attribute[Any], starts: tuple[int, ...]
) -> None:
    edges = [*starts, len(recording)]
    if not all(map(is_whole, starts)) or edges[0] != 0 or not all(np.diff(edges) > 0):
        raise InputError(
            f"trial_starts: expected increasing sample indices from 0 to below {len(recording)}, "
            f"got {starts!r}"
        )


@attrs.frozen(eq=False, repr=False)
class Recording(Signals):
    """Angle and torque of a joint against time, of one trial or of several trials in a row.

    Parameters
    ----------
    angle, torque
        In rad and N·m, shape (time,). The torque is positive where it resists a positive angle.
    sampling_rate
        In Hz.
    start
        Time of the first sample of each trial in s.
    trial_starts
        Index of the first sample of each trial. Filters and cuts do not cross these.
    channels
        Further signals by name, each of shape (time,).
    origin
        Where time 0 of this recording lies on the time axis of the original trial, in s. It is
        above 0 if the beginning of the trial was removed.
    delay_removed
        Delay of the torque in s that :func:`tvsysid.preprocess.align_channels` corrected.
    recorded_angle
        Angle before :func:`tvsysid.preprocess.decimate` lowered its rate, in rad, shape (time,
        sample). Row i holds the recorded samples from sample i of the angle up to, but not
        including, sample i + 1. Methods with a reflex rectify the recorded velocity.

    Raises
    ------
    InputError
        For signals that are not finite numbers of one common length, a constant angle or torque,
        peaks beyond 1e-30 to 1e30, or a sampling rate that is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> angle = np.sin(np.arange(1000) / 50)
    >>> Recording(angle, 80 * angle, sampling_rate=100)
    Recording(10 s at 100 Hz; angle RMS 0.7 rad, torque RMS 56 N·m)
    """

    AXES: ClassVar = ("time",)

    start: float = attrs.field(default=0.0, validator=finite)
    trial_starts: tuple[int, ...] = attrs.field(default=(0,), validator=_check_trial_starts)

    def __repr__(self) -> str:
        trials = f" in {len(self.trial_starts)} trials" if len(self.trial_starts) > 1 else ""
        return (
            f"Recording({self.duration:g} s{trials} at {self.sampling_rate:g} Hz; "
            f"{self._magnitudes()})"
        )

    @property
    def duration(self) -> float:
        """Duration of all trials together, in s."""
        return len(self) / self.sampling_rate

    @property
    def trials(self) -> tuple[slice, ...]:
        """Samples of each trial."""
        ends = (*self.trial_starts[1:], len(self))
        return tuple(map(slice, self.trial_starts, ends))

    @property
    def trial_lengths(self) -> NDArray[np.int64]:
        """Number of samples of each trial, shape (trial,)."""
        return np.diff([*self.trial_starts, len(self)])

    @property
    def time(self) -> Array:
        """Time of each sample within its trial in s, shape (time,)."""
        counts = np.concatenate([*map(np.arange, self.trial_lengths)])
        return self.start + counts / self.sampling_rate


def _to_onsets(onsets: ArrayLike | None, ensemble: Any) -> Array:
    return to_array(np.zeros(len(ensemble)) if onsets is None else onsets)


def _to_trials(trials: ArrayLike | None, ensemble: Any) -> NDArray[np.int64]:
    if trials is None:  # without onsets, each realization is a trial of its own
        count = len(ensemble)
        trials = np.zeros(count) if ensemble.onsets.any() else np.arange(count)
    return read_only(np.asarray(trials).astype(np.int64))


def _check_count(ensemble: Ensemble, field: attrs.Attribute[Any], values: Array) -> None:
    check_finite(field.name, values, ("realization",))
    if len(values) != len(ensemble):
        raise InputError(
            f"{field.name}: expected a value for each of the {len(ensemble)} realizations, got "
            f"{len(values)}"
        )


def _check_context(ensemble: Ensemble, field: attrs.Attribute[Any], context: int) -> None:
    samples = ensemble.angle.shape[1]
    if not is_whole(context) or not 0 <= 2 * context < samples:
        raise InputError(
            f"context: expected a whole number of samples from 0 to {(samples - 1) // 2} (half of "
            f"the {samples} samples given), got {context!r}"
        )


@attrs.frozen(eq=False, repr=False)
class Ensemble(Signals):
    """Realizations of one repeated movement, aligned in time.

    Parameters
    ----------
    angle, torque
        In rad and N·m, shape (realization, context + time + context).
    sampling_rate
        In Hz.
    context
        Number of samples recorded before and after each realization. Lags and windows at the edges
        use these samples. Estimates that need more context are NaN.
    onsets
        Time in s of each realization's first sample after the context, shape (realization,).
        Methods that need a continuous record join realizations of one trial that follow each other
        without a gap. By default no realization follows another.
    trials
        Number of the trial that each realization comes from, shape (realization,).
    left_out
        Number of realizations that lacked context when the record was cut.
    mean_subtracted
        Whether :func:`tvsysid.preprocess.subtract_mean` subtracted the mean over realizations. The
        noise of R realizations then has R - 1 degrees of freedom.
    channels
        Further signals by name, each of the angle's shape.
    origin, delay_removed, recorded_angle
        Values of the recording from which the ensemble was cut. The recorded angle has the shape
        (realization, context + time + context, sample) and keeps its mean.

    Raises
    ------
    InputError
        For signals that are not finite numbers of one common shape, a constant angle or torque,
        peaks beyond 1e-30 to 1e30, a sampling rate that is not positive, or a context that leaves
        no sample.

    Examples
    --------
    >>> import numpy as np
    >>> angle = np.random.default_rng(0).normal(size=(50, 200))
    >>> Ensemble(angle, 80 * angle, sampling_rate=100)
    Ensemble(50 realizations of 2 s at 100 Hz, context 0 s; angle RMS 0.998 rad, torque RMS 79.8
    N·m)
    """

    AXES: ClassVar = ("realization", "time")

    context: int = attrs.field(default=0, validator=_check_context)
    onsets: Array = attrs.field(
        default=None,
        converter=attrs.Converter(_to_onsets, takes_self=True),  # type: ignore[misc]
        validator=_check_count,
    )
    trials: NDArray[np.int64] = attrs.field(
        default=None,
        converter=attrs.Converter(_to_trials, takes_self=True),  # type: ignore[misc]
        validator=_check_count,
    )
    left_out: int = attrs.field(default=0, kw_only=True)
    mean_subtracted: bool = attrs.field(default=False, kw_only=True)

    def __repr__(self) -> str:
        left_out = f", {self.left_out} left out: too near the ends" if self.left_out else ""
        plural = "s" * (len(self) != 1)
        return (
            f"Ensemble({len(self)} realization{plural} of {self.duration:g} s at "
            f"{self.sampling_rate:g} Hz, context {self.context / self.sampling_rate:g} "
            f"s{left_out}; {self._magnitudes()})"
        )

    @property
    def samples(self) -> int:
        """Number of samples of one realization without its context."""
        return int(self.angle.shape[1] - 2 * self.context)

    @property
    def duration(self) -> float:
        """Duration of one realization without its context, in s."""
        return self.samples / self.sampling_rate

    @property
    def time(self) -> Array:
        """Time within a realization in s, shape (time,), without context."""
        return np.arange(self.samples) / self.sampling_rate

    @property
    def core(self) -> slice:
        """Samples of a realization without its context: ``ensemble.torque[:, ensemble.core]``."""
        return slice(self.context, self.context + self.samples)

    @property
    def runs(self) -> tuple[NDArray[np.int64], ...]:
        """Indices of realizations that follow each other without a gap, one array for each run."""
        order = np.lexsort((self.onsets, self.trials))
        onsets, trials = self.onsets[order], self.trials[order]
        half_sample = 0.5 / self.sampling_rate
        ends = (np.abs(np.diff(onsets) - self.duration) > half_sample) | (np.diff(trials) != 0)
        return tuple(np.split(order, np.flatnonzero(ends) + 1))

    def derivatives(self) -> Array:
        """Return the angle and its band-limited first and second derivative.

        They are in rad, rad/s and rad/s², of shape (3, realization, time), without context. They
        are NaN where the filters of :mod:`tvsysid.numerics.differentiation` reach beyond the
        context.
        """
        derivatives = np.full((3, len(self), self.samples), np.nan)
        missing = max(0, HALF_WIDTH - self.context)
        if 2 * missing < self.samples:
            first = max(0, self.context - HALF_WIDTH)
            angle = self.angle[:, first : self.angle.shape[1] - first]
            inner = differentiate(angle, self.sampling_rate)
            derivatives[:, :, missing : self.samples - missing] = inner
        return derivatives

    def select(self, realizations: ArrayLike) -> Ensemble:
        """Return an ensemble of some realizations, given by their indices or by a boolean mask."""
        try:
            index = np.arange(len(self))[np.asarray(realizations)]
        except IndexError as error:
            raise InputError(f"select: these realizations do not exist: {error}") from error
        fields = self.mapped(lambda values: values[index])
        return attrs.evolve(self, **fields, onsets=self.onsets[index], trials=self.trials[index])


def check_ensemble(owner: str, ensemble: object) -> None:
    """Raise InputError if the argument of a function ``owner`` is no ensemble."""
    if not isinstance(ensemble, Ensemble):
        raise InputError(
            f"{owner}: expected an Ensemble, got {type(ensemble).__name__}; cut a Recording with "
            "tvsysid.preprocess.segment"
        )
