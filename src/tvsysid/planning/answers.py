"""What an experiment takes: the question, and the answer of each method."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import attrs
import numpy as np

from tvsysid.checked import Frozen
from tvsysid.errors import InputError
from tvsysid.methods import Method, label_of, parse
from tvsysid.numerics.bands import critical_value
from tvsysid.planning.curves import (
    RECORDS,
    Curve,
    answered,
    curves_of,
    excesses,
    identified,
    rises,
    scatter,
    sizes,
)
from tvsysid.planning.setups import Pilot, Setup, positive, seconds_of
from tvsysid.showing import Progress, Shown, reported, summary_html
from tvsysid.signals import Ensemble

if TYPE_CHECKING:
    import pandas as pd

METHODS = ("adaptive", "sds", "birf", "kbr")  # that a plan is made for, unless others are named
LONGEST, MOST = 2400.0, 320  # seconds and realizations of the largest ensemble that is simulated
BEYOND = 10  # times as many are reached by the law that was found
DRAWS, STEPS = 18, 4  # ensembles of each size, and with a step
HALF = float(critical_value(0.95, np.array([np.inf]))[0])  # standard errors in half a band of 95 %
TRIALS = 40  # by which a plan is verified


class Answer(NamedTuple):
    """What one method needs in one setup, or why no number of realizations suffices.

    ``seconds`` are to be recorded for ``realizations``, with those at both ends that lack
    context. ``half_width`` is half of the 95 % band (N·m/rad) that ``realizations`` give, and
    ``bias`` (N·m/rad) the root mean square over time of what no band counts; where none suffice,
    those of the most that were simulated. ``rise_time`` is the time in s from 10 to 90 % of a
    step. In the pilot, the method scatters ``excess`` times as much as in simulated
    realizations, which is counted.
    """

    setup: str
    method: str
    realizations: int | None
    seconds: float
    half_width: float
    bias: float
    rise_time: float
    excess: float = 1.0
    why: str = ""

    @property
    def duration(self) -> str:
        """Seconds or minutes to record, never rounded down."""
        unit, size = ("s", 1) if self.seconds < 120 else ("min", 60)
        return f"{math.ceil(round(10 * self.seconds / size, 6)) / 10:g} {unit}"


class Verified(NamedTuple):
    """Random error (N·m/rad) that was predicted, and that of simulated ``trials``."""

    setup: str
    method: str
    realizations: int
    predicted: float
    reached: float
    trials: int


@attrs.frozen(eq=False, repr=False)
class Plan(Shown, Frozen):
    """How much must be recorded, in one or several setups, by one or several methods.

    Made by :func:`tvsysid.plan`.

    ``curves`` are errors against realizations, by (setup, method); ``answers`` has one for each
    of these.
    """

    precision: float
    resolution: float | None
    setups: Mapping[str, Setup]
    methods: Mapping[str, Method]
    curves: Mapping[tuple[str, str], Curve]
    answers: tuple[Answer, ...]

    @property
    def multiple(self) -> float:
        """Standard errors in half a band of 95 %."""
        return HALF

    @property
    def best(self) -> Answer | None:
        """Answer with the least recording; None if nothing suffices."""
        enough = [each for each in self.answers if each.realizations is not None and not each.why]
        return min(enough, key=lambda each: each.seconds, default=None)

    def __str__(self) -> str:
        """Answer in a sentence."""
        wish = f"To know stiffness to ± {self.precision:g} N·m/rad at 95 %"
        wish += f" and follow a change within {self.resolution:g} s" if self.resolution else ""
        if self.best is None:
            return f"{wish}: no method suffices, of those tried; see why in the table."
        best, period = self.best, self.setups[self.best.setup].period
        assert best.realizations is not None
        more = (
            ", as those at both ends lack context"
            if best.seconds > best.realizations * period
            else ""
        )
        return (
            f"{wish}, with {best.method} and {best.setup}: {best.realizations} realizations of "
            f"{period:g} s; "
            f"record {best.duration}{more}."
        )

    def __repr__(self) -> str:
        return f"Plan({self})"

    def _repr_html_(self) -> str:
        table = self.table()
        return summary_html(
            "Plan", str(self), list(map(str, table.columns)), table.itertuples(index=False)
        )

    def table(self) -> pd.DataFrame:
        """A row for each setup and method, with units in the names: the fields of its ``answers``."""
        import pandas as pd  # noqa: PLC0415  # heavy

        rows = [
            {
                "setup": each.setup,
                "method": each.method,
                "realizations": each.realizations,
                "minutes": each.seconds / 60,
                "± reached (N·m/rad)": each.half_width,
                "bias (N·m/rad)": each.bias,
                "rise time (s)": each.rise_time,
                "pilot / simulated": each.excess,
                "why not": each.why,
            }
            for each in self.answers
        ]
        return pd.DataFrame(rows).astype({"realizations": "Int64"})

    def verify(
        self, trials: int = TRIALS, seed: int = 1000, *, progress: Progress | None = None
    ) -> list[Verified]:
        """Simulate each answer anew, so many times: random error of the stiffness as predicted, and as reached.

        Of what was planned from a pilot, more of the same is simulated, so that this verifies the
        law and not what was taken from the pilot (the simulated scatter is multiplied by the same
        excess). Answers without a number of realizations are left out.

        Raises
        ------
        InputError
            For fewer than two trials.
        """
        if trials < 2:
            raise InputError(f"verify: trials must be 2 or more, got {trials}")
        planned = [each for each in self.answers if each.realizations is not None]
        found, done = [], 0
        with reported(progress, "verifying") as told:
            for each in planned:
                assert each.realizations is not None
                values = []
                for trial in range(trials):
                    told(done, len(planned) * trials)
                    part = self.setups[each.setup].simulated(each.realizations, seed + trial)
                    values += list(
                        identified(self.methods[each.method], each.method, [part.ensemble], {})
                    )
                    done += 1
                known, curve = answered(np.array(values)), self.curves[each.setup, each.method]
                predicted, reached = (
                    curve.at(each.realizations).random,
                    curve.excess * scatter(known),
                )
                found.append(
                    Verified(
                        each.setup, each.method, each.realizations, predicted, reached, len(known)
                    )
                )
        return found


def plan(
    setup: Ensemble | Setup | Sequence[Setup],
    precision: float = 5.0,
    resolution: float | None = None,
    methods: Iterable[str | Method] = METHODS,
    *,
    draws: int = DRAWS,
    seed: int = 0,
    progress: Progress | None = None,
) -> Plan:
    r"""How many realizations it takes to know stiffness to ± ``precision`` N·m/rad at 95 %.

    Ensembles of 5, 10, 20, … realizations are simulated, some of each size, and identified by each
    method. The random error of its stiffness, and its bias, then follow for any number of
    realizations; what is needed is where

    .. math:: 1.96 \sqrt{Err_{random}^2 + Err_{bias}^2} \le precision

    Parameters
    ----------
    setup
        A pilot's ensemble (:class:`tvsysid.planning.Pilot`), a stated
        :class:`tvsysid.planning.Protocol`, or several setups to be compared, as with other
        perturbations and amplitudes.
    precision
        In N·m/rad; the bias counts with the random error.
    resolution
        Time in s in which an estimate may rise from 10 to 90 % of a step, at most; None if it does
        not matter.
    methods
        Keys with settings if need be (``"sds:window=0.2"``), or methods.
    draws
        Ensembles of each size, 6 at least; fewer of the largest sizes.
    seed
        Of the simulations.
    progress
        Called with the number of identifications done and of all; None shows a bar in a notebook.

    Raises
    ------
    InputError
        For a wish that is not positive, too few draws, unknown methods, or a period that is too
        long to simulate.

    Notes
    -----
    Beyond the largest number that is simulated (320 realizations or 40 minutes) variance is taken to go on falling as
    it did, up to ten times as many. Random error is that of :func:`tvsysid.metrics.random_error`. A joint that differs
    from realization to realization, or tires, is not in it.

    Examples
    --------
    >>> import tvsysid as tv
    >>> setup = tv.planning.Protocol(perturbation="prbs", amplitude=0.01)
    >>> print(tv.plan(setup, precision=8, methods=["birf"], draws=6))
    To know stiffness to ± 8 N·m/rad at 95 %, with birf and prbs of 0.01 rad: ... realizations of
    2 s; record ...
    """
    positive("precision", precision)
    if resolution is not None:
        positive("resolution", resolution)
    if isinstance(draws, bool) or not isinstance(draws, int) or draws < RECORDS:
        raise InputError(f"plan: draws must be a whole number from {RECORDS} on, got {draws!r}")
    setups = _setups(setup)
    named = [methods] if isinstance(methods, str) else list(methods)
    chosen = {label_of(each): parse(each) if isinstance(each, str) else each for each in named}
    if not chosen:
        raise InputError("plan: expected a method at least, got none")
    most = {label: _most(each) for label, each in setups.items()}
    answers, done = list[Answer](), 0
    pilots = {id(each.recorded): each for each in setups.values() if isinstance(each, Pilot)}
    curves: dict[tuple[str, str], Curve] = {}
    total = sum(len(chosen) * (draws * len(sizes(count)) + STEPS) for count in most.values())
    with reported(progress, "planning") as told:

        def advance(count: int) -> None:
            nonlocal done
            done += count
            told(done, total)

        told(0, total)
        excess = {which: excesses(pilot, chosen, draws, seed) for which, pilot in pilots.items()}
        for label, each in setups.items():
            found = curves_of(each, chosen, most[label], draws, seed, advance)
            if isinstance(each, Pilot):
                own = excess[id(each.recorded)]  # whatever is planned from a pilot
                found = {
                    name: attrs.evolve(curve, excess=own[name]) for name, curve in found.items()
                }
            curves |= {(label, method): curve for method, curve in found.items()}
            needed = {
                name: curve.needed(precision / HALF, BEYOND * most[label])
                for name, curve in found.items()
            }
            counts = {
                name: min(number or most[label], most[label]) for name, number in needed.items()
            }
            risen = rises(each, chosen, counts, STEPS, seed + RECORDS, advance)
            answers += [
                _answer(
                    each,
                    name,
                    curve,
                    needed[name],
                    counts[name],
                    risen[name],
                    precision,
                    resolution,
                )
                for name, curve in found.items()
            ]
        told(total, total)
    return Plan(precision, resolution, setups, chosen, curves, tuple(answers))


def _setups(given: Ensemble | Setup | Sequence[Setup]) -> dict[str, Setup]:
    """What is planned, by label; a pilot's ensemble as what it shows."""
    several: Sequence[object] = given if isinstance(given, Sequence) else [given]
    found: dict[str, Setup] = {}
    for each in several:
        if not isinstance(each, Ensemble | Setup):
            raise InputError(
                "plan: expected a pilot's Ensemble, a Protocol or a Pilot, got "
                f"{type(each).__name__}; segment a "
                "Recording first"
            )
        made = Pilot.of(each) if isinstance(each, Ensemble) else each
        found[str(made)] = made
    if not found or len(found) < len(several):
        raise InputError("plan: expected setups that differ in perturbation or amplitude")
    return found


def _most(setup: Setup) -> int:
    most = min(MOST, int(LONGEST / setup.period))
    if most < 10:
        raise InputError(
            f"plan: realizations of {setup.period:g} s are too long to plan with: 240 s are the "
            "most"
        )
    return most


def _answer(
    setup: Setup, method: str, curve: Curve, needed: int | None, tried: int, rise: float,
    precision: float, resolution: float | None,
) -> Answer:  # fmt: skip
    """What a curve says of the wish."""
    errors, why = curve.at(needed or tried), []
    if not curve.realizations.size:
        why = [curve.why or "it gives no stiffness"]
    elif needed is None and errors.bias * HALF > precision:
        why = [f"its bias alone is ± {HALF * errors.bias:.2g} N·m/rad, however much is recorded"]
    elif needed is None:
        why = [f"{BEYOND * tried} realizations are too few"]
    if resolution is not None and not rise <= resolution:
        why += [
            f"it takes {rise:.2g} s to follow a step"
            if math.isfinite(rise)
            else "it does not follow a step"
        ]
    seconds = seconds_of(setup, needed or tried)
    return Answer(
        str(setup),
        method,
        needed,
        seconds,
        HALF * errors.random,
        errors.bias,
        rise,
        curve.excess,
        "; ".join(why),
    )
