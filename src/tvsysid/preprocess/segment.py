"""From a recording to realizations: lower its rate, take its ends off, cut it, take out what they have in common."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable
from typing import TypedDict

import attrs
import numpy as np

from tvsysid.checked import checked_rate
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.numerics.decimation import SHARP, TAPS, keep_every
from tvsysid.numerics.interpolation import SINC, between
from tvsysid.preprocess.gaps import Gap
from tvsysid.preprocess.repeated import repeated_lines
from tvsysid.signals import Array, Ensemble, Recording

ROUNDING = 1e-9
SMEARED = 0.015  # s to either side of a gap over which decimation smears it
SLOWEST = (
    40.0  # Hz below which too little of a joint's response is left to tell stiffness from inertia
)
DIFFER = (
    "the perturbation must differ from realization to realization: a multisine needs lines that "
    "are no multiples of "
    "1/period"
)
# share of its change from sample to sample below which what differs between realizations is noise
# alone
ALIKE = 3e-3


class Signals(TypedDict):
    """Signals as a recording or an ensemble takes them."""

    angle: Array
    torque: Array
    channels: dict[str, Array]
    recorded_angle: Array | None


def every_signal(signals: Recording | Ensemble, change: Callable[[Array], Array]) -> Signals:
    """Angle, torque and channels, each changed alike.

    What was recorded of the angle has one axis more.
    """
    recorded = signals.recorded_angle
    return {
        "angle": change(signals.angle),
        "torque": change(signals.torque),
        "channels": {name: change(values) for name, values in signals.channels.items()},
        "recorded_angle": None if recorded is None else change(recorded),
    }


def check_seconds(step: str, *, positive: bool = False, **durations: float) -> None:
    """Raise for durations that are not numbers of seconds, zero or more."""
    expected = "a positive number of seconds" if positive else "a number of seconds, zero or more"
    for name, seconds in durations.items():
        is_number = isinstance(seconds, (int, float, np.number)) and math.isfinite(seconds)
        if not is_number or seconds < 0 or (positive and seconds == 0):
            raise InputError(f"{step}: {name} must be {expected}, got {seconds!r}")


def fitting_rates(recorded: float, rate: float) -> list[float]:
    """Rates in Hz to which one can decimate, in whole Hz where there are such, the nearest to ``rate`` first."""
    every = [recorded / r for r in range(1, max(2, int(recorded)))]
    whole = [fit for fit in every if fit == round(fit)] or every
    return sorted(whole, key=lambda fit: abs(fit - rate))


def decimate(recording: Recording, rate: float, *, sharp: bool = False) -> Recording:
    r"""Low-pass and keep every r-th sample, r being the ratio of the rates.

    The filter is a 31-tap Hamming-window FIR with -6 dB at the new Nyquist frequency; its delay is
    removed, so that the first sample stays the first. Ends (of each trial) are continued by odd
    reflection. The angle as it was recorded is kept beside (``recorded_angle``), for methods that
    rectify its velocity. Angle, torque and channels (EMG as well: take its envelope before, if that
    is what counts) all pass the same filter, which therefore cancels in the identification of what
    does not vary; a sudden change is smeared over :math:`\pm 15` samples of the old rate.

    Parameters
    ----------
    recording
        Trials that are no shorter than the filter.
    rate
        New sampling rate in Hz; must divide the old one.
    sharp
        A filter of 20 r + 1 taps, for a record whose angle and torque reach beyond the new Nyquist
        frequency: 31 taps let that pass as slower movements (aliases), which no method can explain.
        It smears a sudden change over
        :math:`\pm 10` samples of the new rate.

    Warns
    -----
    DataQualityWarning
        If the new rate is below 40 Hz, which leaves too little of a joint's response.

    References
    ----------
    van de Ruit et al. 2021, sections 3.1.3 and 4.1.4 (50-Hz, respectively 64-Hz, 30th-order low-pass).
    """
    rate = checked_rate(rate)
    ratio = recording.sampling_rate / rate
    factor = round(ratio)
    if factor < 1 or abs(ratio - factor) > 1e-9 * ratio:
        fits = sorted(fitting_rates(recording.sampling_rate, rate)[:4])
        raise InputError(
            f"decimate: {recording.sampling_rate:g} Hz is not a whole multiple of {rate:g} Hz; "
            f"rates that fit nearby: {', '.join(f'{fit:g}' for fit in fits)} Hz"
        )
    if factor == 1:
        return recording
    shortest = min(trial.stop - trial.start for trial in recording.trials)
    taps = SHARP * factor + 1 if sharp else TAPS
    if shortest < taps:
        raise InputError(
            f"decimate: a trial of {shortest} samples is shorter than the filter's {taps} samples"
        )
    if rate < SLOWEST:
        warnings.warn(
            f"decimated to {rate:g} Hz, nothing faster than {rate / 2:g} Hz is left, which hardly "
            "tells a joint's "
            "stiffness from its viscosity and inertia; give the new rate in Hz (100 is usual), "
            "not a factor",
            DataQualityWarning,
            stacklevel=2,
        )

    def lower(x: Array) -> Array:
        return np.concatenate([keep_every(x[trial], factor, taps) for trial in recording.trials])

    starts = _starts(-(-(trial.stop - trial.start) // factor) for trial in recording.trials)
    recorded = np.concatenate([_recorded(recording, trial, factor) for trial in recording.trials])
    lowered = every_signal(attrs.evolve(recording, recorded_angle=None), lower) | {
        "recorded_angle": recorded
    }
    return attrs.evolve(recording, **lowered, sampling_rate=rate, trial_starts=starts)


def _recorded(recording: Recording, trial: slice, factor: int) -> Array:
    """What was recorded of a trial's angle, by samples of the lower rate.

    Its last sample fills the last of them.
    """
    angle = recording.angle_as_recorded
    missing = -(trial.stop - trial.start) % factor
    size = angle.shape[1]
    return np.pad(angle[trial].ravel(), (0, missing * size), "edge").reshape(-1, factor * size)


def _starts(lengths: Iterable[int]) -> tuple[int, ...]:
    """First samples of trials of so many samples."""
    return (0, *np.cumsum(list(lengths)).tolist()[:-1])


def align_channels(recording: Recording, delay: float) -> Recording:
    """Take the torque so much earlier, to correct a delay between the channels: that of its filter, or of its clock.

    Between samples, the torque is interpolated (windowed sinc). Samples for which no torque was
    recorded are cut off one end of each trial; the times of the others stay. Further channels stay
    with the angle. The recording's ``delay_removed`` states what was corrected; ensembles that are
    cut from it have it, and the models' diagnostics.

    Parameters
    ----------
    delay
        Seconds by which the torque was recorded later than the angle; negative where it was
        earlier. The finding ``delay`` of :func:`tvsysid.diagnose` estimates it, in ms. Correct it
        before decimating.

    Raises
    ------
    InputError
        For a delay that is not a number, or as long as a trial.

    Examples
    --------
    >>> import numpy as np
    >>> angle = np.sin(np.arange(1000) / 50)
    >>> late = Recording(angle[3:], 80 * angle[:-3], sampling_rate=1000)
    >>> mended = align_channels(late, 0.003)
    >>> bool(np.allclose(mended.torque, 80 * mended.angle)), len(mended), mended.delay_removed
    (True, 994, 0.003)
    """
    if not (isinstance(delay, (int, float, np.number)) and math.isfinite(delay)):
        raise InputError(f"align_channels: delay must be a number of seconds, got {delay!r}")
    samples = float(delay * recording.sampling_rate)
    whole = round(samples)
    lost = math.ceil(abs(samples) - 1e-9)
    shortest = min(trial.stop - trial.start for trial in recording.trials)
    if lost >= shortest:
        seconds = shortest / recording.sampling_rate
        raise InputError(
            f"align_channels: a delay of {delay:g} s leaves nothing of a trial of {seconds:g} s"
        )
    head, tail = (lost, 0) if samples < 0 else (0, lost)
    kept = [slice(trial.start + head, trial.stop - tail) for trial in recording.trials]

    def earlier(torque: Array) -> Array:
        late = between(np.pad(torque, SINC, "reflect", reflect_type="odd"), samples - whole)[
            SINC:-SINC
        ]
        return late[np.clip(np.arange(head, len(torque) - tail) + whole, 0, len(torque) - 1)]

    signals = every_signal(
        recording, lambda values: np.concatenate([values[trial] for trial in kept])
    )
    signals["torque"] = np.concatenate(
        [earlier(recording.torque[trial]) for trial in recording.trials]
    )
    return attrs.evolve(
        recording,
        **signals,
        start=recording.start + head / recording.sampling_rate,
        trial_starts=_starts(trial.stop - trial.start for trial in kept),
        delay_removed=recording.delay_removed + delay,
    )


def trim(recording: Recording, ends: float, margin: float = 0.0) -> Recording:
    """Remove the first and last seconds of each trial, and count its time from where what is left begins.

    Parameters
    ----------
    ends
        Seconds to remove at both ends of each trial; something must be left of it.
    margin
        Seconds of the ends that are kept for context, at negative times and after the end: the
        recording that is returned begins ``margin`` seconds before time 0.
    """
    check_seconds("trim", ends=ends, margin=margin)
    if margin > ends:
        raise InputError(
            f"trim: a margin of {margin:g} s cannot be kept of ends of {ends:g} s; give a shorter "
            "one"
        )
    rate = recording.sampling_rate
    outside, kept_outside = round(ends * rate), round(margin * rate)
    cut = outside - kept_outside
    shortest = min(trial.stop - trial.start for trial in recording.trials)
    if shortest <= 2 * outside:
        raise InputError(
            f"trim: ends of {ends:g} s leave nothing of a trial of {shortest / rate:g} s"
        )
    inner = [slice(trial.start + cut, trial.stop - cut) for trial in recording.trials]

    def trimmed(x: Array) -> Array:
        return np.concatenate([x[trial] for trial in inner])

    starts = _starts(trial.stop - trial.start for trial in inner)
    return attrs.evolve(
        recording,
        **every_signal(recording, trimmed),
        start=-kept_outside / rate,
        trial_starts=starts,
        origin=recording.origin + recording.start + outside / rate,
    )


def segment(
    recording: Recording, period: float | None, context: float = 0.5, gaps: Iterable[Gap] = ()
) -> Ensemble:
    """Cut each trial into all the realizations that it holds whole, which begin at multiples of the period from time 0.

    Parameters
    ----------
    period
        Duration of a realization in s: a whole number of samples. None, for behaviour that is not
        repeated, makes one realization of each trial, all as long as the shortest but for its
        context.
    context
        Seconds of the record that each realization keeps on either side. Realizations at the ends
        that lack it are left out, and ``left_out`` of the ensemble counts them; 0 keeps them all.
    gaps
        Those that :func:`tvsysid.preprocess.find_gaps` found before the recording was decimated.
        Realizations that hold a part of one, context counted, are left out; without a period none
        is.
    """
    rate = recording.sampling_rate
    check_seconds("segment", context=context)
    margin = round(context * rate)
    if period is None:
        return _cut(
            recording, [[margin]] * len(recording.trials), _longest(recording, margin), margin
        )
    check_seconds("segment", period=period)
    if round(period * rate) < 1:
        raise InputError(
            f"segment: a period of {period!r} s is shorter than a sample at {rate:g} Hz"
        )
    samples = _whole_samples(period, rate)
    firsts: list[list[int]] = []
    left_out = 0
    reach, first_time = margin + math.ceil(SMEARED * rate), recording.origin + recording.start
    lost = [
        (gap.trial, (gap.start - first_time) * rate - reach, (gap.stop - first_time) * rate + reach)
        for gap in gaps
    ]
    for number, trial in enumerate(recording.trials):
        length = trial.stop - trial.start
        # First multiple of the period at or after the trial's first sample, as a sample of the
        # trial.
        first = math.ceil(round(recording.start * rate) / samples) * samples - round(
            recording.start * rate
        )
        whole = range(first, length - samples + 1, samples)
        firsts.append([i for i in whole if i >= margin and i + samples + margin <= length])
        left_out += len(whole) - len(firsts[-1])
        for start, stop in (ends for trial_number, *ends in lost if trial_number == number):
            firsts[-1] = [i for i in firsts[-1] if i + samples <= start or i >= stop]
    if not any(firsts):
        if lost:
            raise InputError(
                f"segment: no realization of {period:g} s is without a gap; give no gaps to keep "
                "them all"
            )
        longest = max(trial.stop - trial.start for trial in recording.trials) / rate
        less = "give less context (--context 0 keeps every realization)"
        if len(recording.trials) > 1:
            less += (
                ", or, if the trials follow each other in time, read them as one (--columns "
                "contiguous)"
            )
        raise InputError(
            f"segment: no realization of {period:g} s with {context:g} s of context on both sides "
            "fits into "
            f"{longest:g} s of record from {recording.start:g} s on; "
            f"{less if left_out else 'give a shorter period (--period)'}"
        )
    return _cut(recording, firsts, samples, margin, left_out)


def _longest(recording: Recording, margin: int) -> int:
    """Samples of the shortest trial without its context."""
    shortest = min(trial.stop - trial.start for trial in recording.trials)
    if shortest <= 2 * margin:
        raise InputError(
            f"segment: a trial of {shortest / recording.sampling_rate:g} s has nothing left within "
            f"{margin / recording.sampling_rate:g} s of context on both sides; give less context "
            "(--context)"
        )
    return int(shortest - 2 * margin)


def _cut(
    recording: Recording,
    firsts: Iterable[Iterable[int]],
    samples: int,
    margin: int,
    left_out: int = 0,
) -> Ensemble:
    """Realizations with their context; by trial, the sample of it with which each begins."""
    places = [(number, first) for number, each in enumerate(firsts) for first in each]
    trials, within = np.array(places).T
    index = within + np.array(recording.trial_starts)[trials]

    def cut(x: Array) -> Array:
        return np.asarray(x[(index - margin)[:, None] + np.arange(samples + 2 * margin)])

    return Ensemble(
        **every_signal(recording, cut),
        sampling_rate=recording.sampling_rate,
        context=margin,
        onsets=recording.start + within / recording.sampling_rate,
        trials=trials,
        left_out=left_out,
        origin=recording.origin,
        delay_removed=recording.delay_removed,
    )


def _whole_samples(period: float, rate: float) -> int:
    samples = period * rate
    if abs(samples - round(samples)) > 1e-6 * max(1.0, samples):
        raise InputError(
            f"segment: period {period:g} s is not a whole number of samples at {rate:g} Hz "
            f"({samples:g}); "
            "give a rate at which it is one (--decimate, or decimate); realizations of a rounded "
            "period would drift"
        )
    return round(samples)


def subtract_mean(ensemble: Ensemble, channels: Iterable[str] = ()) -> Ensemble:
    """Subtract from angle and torque, at each time, their mean over realizations, and set ``mean_subtracted``.

    What all realizations share (the voluntary torque, an imposed movement) is no answer to the
    perturbation. The angle with its mean stays as ``recorded_angle``.

    Parameters
    ----------
    ensemble
        At least two realizations.
    channels
        Channels that lose their mean too: those that act on angle or torque, such as a reference
        signal or the EMG that drives a reflex. A channel that only schedules the joint's properties
        keeps it.

    Raises
    ------
    InputError
        For one realization, and where angle or channel hardly differ between realizations: their
        changes from sample to sample by less than 0.3 %. A perturbation of 0.5 degrees beside a
        movement of 60 degrees leaves 8 %; noise that moves an actuator of 100 kN·m/rad, 0.1 %. Of a
        softer one it leaves more: there, where lines that are multiples of 1/period hold most of
        the angle's movement above 5 Hz, and the rest does not answer as a joint does.
    """
    if len(ensemble) < 2:
        out, context = ensemble.left_out, ensemble.context / ensemble.sampling_rate
        lost = (
            f" ({1 + out} fit in, {out} left out for want of {context:g} s of context on both "
            "sides)"
            if out
            else ""
        )
        less = ", or with less context (--context 0 leaves out none)" if out else ""
        raise InputError(
            f"subtract_mean: expected at least two realizations, got one{lost}; its mean is the "
            "signal itself; record "
            f"more, or cut the recording with a shorter period (--period){less}"
        )
    channels, deviations = tuple(channels), {}
    for name in dict.fromkeys(("angle", "torque", *channels)):
        values = ensemble.signal(name)
        deviations[name] = values - values.mean(axis=0)
        left = _differing(values, deviations[name])
        if left <= (ROUNDING if name == "torque" else ALIKE):  # torque has noise of its own
            raise InputError(
                f"subtract_mean: the {name} is the same in all {len(ensemble)} realizations, "
                "which differ by "
                f"{100 * left:.1g} %, so that nothing but noise is left; {DIFFER}"
            )
    lines, share = repeated_lines(ensemble)
    if (
        lines.size and not channels
    ):  # of a channel that differs, such as the disturbance, it was seen above
        raise InputError(
            f"subtract_mean: the perturbation is the same in all {len(ensemble)} realizations: "
            "lines at "
            f"{', '.join(f'{line:g}' for line in lines)} Hz hold {100 * share:.0f} % of the "
            "angle's fast movement, and "
            f"what differs is no answer of the joint, so that nothing but noise is left; {DIFFER}"
        )
    pair = {name: deviations.pop(name) for name in ("angle", "torque")}
    changes = pair | {"recorded_angle": ensemble.angle_as_recorded}
    return attrs.evolve(
        ensemble, **changes, channels={**ensemble.channels, **deviations}, mean_subtracted=True
    )


def _differing(values: Array, deviations: Array) -> float:
    """Share of the change from sample to sample by which realizations differ.

    Of the values, where these are still.
    """
    sums = [float(np.sum(np.diff(each) ** 2)) for each in (deviations, values)]
    if not sums[1]:
        sums = [float(np.sum(each**2)) for each in (deviations, values)]
    return math.sqrt(sums[0] / sums[1]) if sums[1] else 0.0
