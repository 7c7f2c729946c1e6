"""Plan a recording: the recording that each method needs."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

import attrs
import numpy as np

from tvsysid.methods import Method, label_of, parse
from tvsysid.numerics.bands import critical_value
from tvsysid.planning.curves import DRAWS, Curve, measure_curve, measure_rise
from tvsysid.planning.protocol import Protocol
from tvsysid.progress import Progress, no_progress
from tvsysid.signals import Ensemble
from tvsysid.validators import positive

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

MARGIN = 1.1  # as the few simulated ensembles show an error to 10 %
EXTRAPOLATION = 10  # times as many realizations follow the fitted law
MIN_REALIZATIONS = 20  # to record; plans of fewer are optimistic
# Heading of each value of a required recording, its name, and its format.
COLUMNS = {
    "setup": "setup",
    "method": "method",
    "realizations": "realizations:d",
    "record (s)": "seconds:g",
    "± noise": "noise:.1f",
    "± bias": "bias:.1f",
    "± both": "both:.1f",
    "follows a step (s)": "rise_time:.2f",
    "pilot / simulated": "excess:.1f",
    "why not": "why",
}
HALF_BAND = float(critical_value(0.95, np.array([np.inf]))[0])  # in standard errors, at 95 %


class RequiredRecording(NamedTuple):
    """Recording that one method needs in one setup, or why no number of realizations suffices.

    Parameters
    ----------
    setup, method
        Labels.
    realizations
        Number of realizations that suffices, or None.
    seconds
        Duration to record, with the realizations at both ends that lack context; NaN if none
        suffices.
    noise, bias, both
        1.96 times random error, bias error and both in N·m/rad with these realizations; with the
        most that were simulated if none suffice.
    rise_time
        Time in s from 10 to 90 % of a step.
    excess
        Scatter of the method in the pilot over that in simulated realizations, which is counted.
    why
        Why the method does not suffice; empty if it does.
    """

    setup: str
    method: str
    realizations: int | None
    seconds: float
    noise: float
    bias: float
    both: float
    rise_time: float
    excess: float = 1.0
    why: str = ""


@attrs.frozen(eq=False, repr=False)
class Plan:
    """How much to record, in one or several setups, by one or several methods.

    Made by :func:`tvsysid.plan`. ``curves`` are errors against realizations, by (setup, method).
    ``required`` has one for each of these. Half a band of 95 % is ``multiple`` standard errors.
    """

    precision: float
    resolution: float | None
    setups: Mapping[str, Protocol]
    methods: Mapping[str, Method]
    curves: Mapping[tuple[str, str], Curve]
    required: tuple[RequiredRecording, ...]

    multiple = HALF_BAND

    @property
    def best(self) -> RequiredRecording | None:
        """Return the shortest recording that suffices; None if nothing suffices."""
        enough = (each for each in self.required if not each.why)
        return min(enough, key=attrgetter("seconds"), default=None)

    def __str__(self) -> str:
        """Say in a sentence how much to record."""
        wish = f"To know stiffness to ± {self.precision:g} N·m/rad at 95 %"
        wish += f" and follow a change within {self.resolution:g} s" if self.resolution else ""
        if (best := self.best) is None:
            return f"{wish}: no method suffices, of those tried; see why in the table."
        setup, needed = self.setups[best.setup], best.realizations or 0
        count = max(needed, MIN_REALIZATIONS)
        seconds = setup.seconds(count)
        more = ", because those at both ends are left out"
        more = more if seconds > count * setup.period else ""
        advice = ""
        if count > needed:
            advice = f" {needed} suffice in simulations, but below {count} real errors are "
            advice += f"larger: record at least {count}."
        return (
            f"{wish}, with {best.method} and {best.setup}: {count} realizations of "
            f"{setup.period:g} s; record {seconds:g} s{more}.{advice}"
        )

    def plot(self, title: str = "") -> Figure:
        """Draw errors against realizations."""
        from tvsysid.figures import plot  # noqa: PLC0415  # figures stand above

        return plot(self, title)

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(str(self))}</p>{self.table().to_html(index=False)}"

    def table(self) -> pd.DataFrame:
        """Return a table of the required recordings. The ± are in N·m/rad."""
        import pandas as pd  # noqa: PLC0415  # heavy

        table = pd.DataFrame(self.required).set_axis(list(COLUMNS), axis=1)
        return table.astype({"realizations": "Int64"})


def plan(
    setup: Ensemble | Protocol | Sequence[Ensemble | Protocol],
    precision: float = 5.0,
    resolution: float | None = None,
    methods: Iterable[str | Method] = ("adaptive", "sds", "birf", "kbr"),
    *,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Plan:
    r"""Find how many realizations it takes to know stiffness to ± ``precision`` at 95 %.

    Ensembles of 10, 40 and 160 realizations are simulated (from a pilot, 20 and 80), six of each
    size, and identified by each method. They give the random error and the bias of its stiffness
    for 10 (20) realizations or more. A number suffices where

    .. math:: 1.1 \cdot 1.96 \sqrt{Err_{random}^2 + Err_{bias}^2} \le precision

    The factor of 1.1 allows for the chance in six ensembles.

    Parameters
    ----------
    setup
        A pilot's ensemble, a :class:`tvsysid.planning.Protocol`, or several of them to compare, as
        with other perturbations and amplitudes.
    precision
        Half of the 95 % band in N·m/rad. The bias counts with the random error.
    resolution
        Longest time in s in which an estimate may rise from 10 to 90 % of a step; None for any.
    methods
        Keys with settings if need be (``"sds:window=0.2"``), or methods.
    seed
        Random seed of the simulations.
    progress
        Function that is called with the number of steps done and of all: one for each method in
        each setup.

    Raises
    ------
    InputError
        For a precision that is not positive, an unknown method, or what is neither an ensemble nor
        a protocol.

    Notes
    -----
    Beyond the largest number that is simulated (160 realizations, or 80 of a pilot), variance goes
    on falling as it did, up to ten times as many. Random error is that of
    :func:`tvsysid.metrics.random_error`. The plan does not know of a joint that differs from
    realization to realization, or tires.

    Examples
    --------
    >>> import tvsysid as tv
    >>> setup = tv.planning.Protocol(perturbation="prbs", amplitude=0.01)
    >>> print(tv.plan(setup, precision=8, methods=["birf"]))
    To know stiffness to ± 8 N·m/rad at 95 %, with birf and the prbs perturbation at 0.01 rad RMS:
    ... realizations of 2 s; record ...
    """
    positive.check("plan", "precision", precision)
    given = setup if isinstance(setup, Sequence) else [setup]
    protocols = [each if isinstance(each, Protocol) else Protocol.of(each) for each in given]
    setups = {str(each): each for each in protocols}
    chosen = {label_of(each): parse(each) if isinstance(each, str) else each for each in methods}
    curves: dict[tuple[str, str], Curve] = {}
    required = list[RequiredRecording]()
    progress(0, len(setups) * len(chosen))
    for label, protocol in setups.items():
        most, stepped = protocol.sizes[-1], protocol.stepped()
        records = [protocol.simulated(most, seed + number) for number in range(DRAWS)]
        for name, method in chosen.items():
            curve = curves[label, name] = measure_curve(method, protocol, records, seed)
            number = curve.needed(precision / HALF_BAND / MARGIN, EXTRAPOLATION * most)
            why = [] if number else [_why_not(curve, most, precision)]
            count = min(number or most, most)
            rise = measure_rise(method, stepped.simulated(count, seed)) if stepped else math.nan
            if resolution is not None and not rise <= resolution:
                why.append(f"it takes {rise:.2g} s to follow a step")
            random, bias, both = (HALF_BAND * each for each in curve.at(number or most))
            errors = protocol.seconds(number or math.nan), random, bias, both, rise, curve.excess
            required.append(RequiredRecording(label, name, number, *errors, "; ".join(why)))
            progress(len(required), len(setups) * len(chosen))
    return Plan(precision, resolution, setups, chosen, curves, tuple(required))


def _why_not(curve: Curve, most: int, precision: float) -> str:
    """Return why no number of realizations suffices."""
    if not curve.realizations.size:
        return curve.why or "it gives no stiffness"
    half_width = HALF_BAND * curve.at(most).bias
    if MARGIN * half_width > precision:
        return f"its bias alone is ± {half_width:.1f} N·m/rad, however much is recorded"
    return f"{EXTRAPOLATION * most} realizations are too few"
