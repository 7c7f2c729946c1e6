"""`tvsysid plan`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tvsysid.cli import options
from tvsysid.cli.console import progress, say, say_written, show_table, shown_warnings
from tvsysid.cli.options import option
from tvsysid.cli.running import check_folder
from tvsysid.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tvsysid.planning import Plan, Protocol
    from tvsysid.planning.setups import Setup
    from tvsysid.signals import Ensemble, Recording

METHODS = ["adaptive", "sds", "birf", "kbr"]  # of tvsysid.planning, which takes long to import
TRUSTED = 20  # realizations from which on plans and bands are no best case
TOLD = 1.1  # times as much scatter as simulated, from which on it is said


def plan(
    precision: Annotated[
        float, option("N·M/RAD", "Stiffness is to be known to ± this at 95 %, bias included.")
    ] = 5.0,
    resolution: Annotated[
        float | None, option("S", "A step is to be followed within this time (10 to 90 %). [any]")
    ] = None,
    method: options.MethodOption = METHODS,
    perturbation: Annotated[
        list[str],
        option(
            "NAME",
            "Perturbation, as of `tvsysid simulate`; repeatable, to compare. [noise; with --pilot "
            "that of the pilot]",
        ),
    ] = [],
    amplitude: Annotated[
        list[float],
        option(
            "RAD",
            "RMS of the angle; repeatable, to compare. [0.0087, half a degree; with --pilot the "
            "pilot's]",
        ),
    ] = [],
    system: Annotated[
        str | None, option("NAME", "What is recorded, as of `tvsysid simulate`. [joint]")
    ] = None,
    stiffness: Annotated[
        str | None, option("NAME", "Its stiffness over a realization. [sine]")
    ] = None,
    noise: Annotated[
        float | None, option("N·M", "RMS of the torque's noise, whatever the amplitude.")
    ] = None,
    snr: Annotated[
        float | None,
        option(
            "DB", "In place of --noise: signal-to-noise ratio at an amplitude of 0.0087 rad. [10]"
        ),
    ] = None,
    pilot: Annotated[
        Path | None,
        option(
            "FILE",
            "Recording to take joint, noise and perturbation from. Needs --angle, --torque, "
            "--rate.",
        ),
    ] = None,
    angle: Annotated[str | None, options.ANGLE] = None,
    torque: Annotated[str | None, options.TORQUE] = None,
    rate: Annotated[float | None, options.RATE] = None,
    period: Annotated[float, options.PERIOD] = 2.0,
    decimate: options.DecimateOption = None,
    columns: options.ColumnsOption = "contiguous",
    torque_sign: options.TorqueSignOption = 1,
    angle_unit: options.AngleUnitOption = "rad",
    start: options.StartOption = 0.0,
    context: options.ContextOption = 0.5,
    verify: Annotated[
        bool,
        option(
            "",
            "Simulate each answer anew, 40 times, and print predicted and reached error.",
            "--verify",
        ),
    ] = False,
    seed: Annotated[int, option("N", "Seed of the random numbers.")] = 0,
    out: options.OutOption = Path("tvsysid-plan"),
) -> None:
    """Say how much to record for stiffness of a wished precision.

    Simulates ensembles of 5, 10, 20, … realizations of a stated joint and protocol, or of what a
    pilot recording shows, and identifies them by each method. How far its stiffness scatters, and
    how far it is off in the mean, says how many realizations it needs. A second simulation, of a
    joint whose stiffness steps, says how fast a change each method can follow.

    Prints the shortest recording that suffices, and for each method: realizations, how long to
    record (with those at both ends that lack context), half the width of the 95 % band that they
    give, bias (which no band counts), and the time in which it follows a step. Where no number
    suffices, it says why. Writes `plan.png` and `plan.csv` to the folder.

    Example: `tvsysid plan --precision 5 --perturbation noise --perturbation prbs --amplitude 0.01
    --noise 0.3`

    Example: `tvsysid plan --precision 3 --resolution 0.05 --pilot pilot.mat --angle pos --torque
    tq --rate 1000 --decimate 100 --period 2`
    """
    import tvsysid
    from tvsysid.figures import save
    from tvsysid.planning import Pilot
    from tvsysid.planning.setups import CONTEXT
    from tvsysid.recordings import whole_file
    from tvsysid.validators import with_settings

    if not out.is_dir():
        check_folder(out)
    stated = options.given(system=system, stiffness=stiffness, noise=noise, snr=snr)
    if pilot is None:
        of_pilot = {
            "angle": angle is None,
            "torque": torque is None,
            "rate": rate is None,
            "start": start == 0,
        }
        of_pilot |= {"columns": columns == "contiguous", "torque-sign": torque_sign == 1}
        of_pilot |= {"angle-unit": angle_unit == "rad", "context": context == CONTEXT}
        if said := [f"--{name}" for name, usual in of_pilot.items() if not usual]:
            raise InputError(
                f"{', '.join(said)}: said of a pilot recording; give that too (--pilot FILE)"
            )
        if noise is not None and snr is not None:
            raise InputError("--noise and --snr: give one of them")
        own: dict[str, Any] = {
            "snr_db" if name == "snr" else name: value for name, value in stated.items()
        }
        own |= {"period": period, "rate": decimate or 100.0}
        setups: Sequence[Setup] = _stated(perturbation or ["noise"], amplitude, own)
    else:
        if stated:
            raise InputError(
                f"--pilot {pilot}: the pilot shows what --{' and --'.join(stated)} would state; "
                "leave it out"
            )
        if angle is None or torque is None or rate is None:
            raise InputError("--pilot needs --angle, --torque and --rate, as `tvsysid identify`")
        with shown_warnings():
            recording = options.read(
                pilot, angle, torque, rate, columns, torque_sign, angle_unit, start
            )
            first = Pilot.of(_cut(recording, decimate, period, context))
        say(f"pilot: {first.described()}")
        setups = [
            with_settings(first, perturbation=name, amplitude=size)
            for name in (perturbation or (first.perturbation,))
            for size in amplitude or [first.amplitude]
        ]
    with progress("planning") as advance:
        found = tvsysid.plan(setups, precision, resolution, method, seed=seed, progress=advance)
    _show(found)
    out.mkdir(parents=True, exist_ok=True)
    with whole_file(out / "plan.csv") as file:
        found.table().to_csv(file, index=False, float_format="%.6g")
    save(found.plot(), out / "plan.png")
    say_written(out, ["plan.csv", "plan.png"])
    if verify:
        _verify(found)


def _stated(
    perturbations: list[str], amplitudes: list[float], stated: dict[str, Any]
) -> list[Protocol]:

    from tvsysid.planning import Protocol

    sizes = amplitudes or [Protocol().amplitude]
    return [
        Protocol(perturbation=name, amplitude=size, **stated)
        for name in perturbations
        for size in sizes
    ]


def _cut(recording: Recording, decimate: float | None, period: float, context: float) -> Ensemble:
    from tvsysid import preprocess

    recording = preprocess.decimate(recording, decimate) if decimate is not None else recording
    return preprocess.subtract_mean(preprocess.segment(recording, period, context))


def _show(found: Plan) -> None:
    """Print the answer, for each setup a row for each method, and why some do not suffice."""
    say((str(found), "bold"))
    if found.best and (found.best.realizations or 0) < TRUSTED:
        say(f"with fewer than {TRUSTED} realizations this is the best case: record {TRUSTED}")
    headings = ["method", "realizations", "record", "± reached", "bias", "follows a\nstep in"]
    for setup in found.setups:
        answers = [each for each in found.answers if each.setup == setup]
        rows = [
            (
                each.method,
                f"{each.realizations or 'none'}{' *' if each.why else ''}",
                "-" if each.realizations is None else each.duration,
                _number(each.half_width),
                _number(each.bias),
                _number(each.rise_time, "{:.2f} s"),
            )
            for each in answers
        ]
        show_table(setup, headings, rows)
        for each in answers:
            if each.why:
                say(f"  * {each.method} does not suffice: {each.why}")
            if each.excess > TOLD:
                say(
                    f"  {each.method} scatters {each.excess:.2g} times as much in the pilot as "
                    "simulated: counted"
                )
    say("± reached: half the 95 % band that so many realizations give; bias is not in it (N·m/rad)")


def _verify(found: Plan) -> None:
    with progress("verifying") as advance:
        verified = found.verify(progress=advance)
    bias = {(each.setup, each.method): each.bias for each in found.answers}
    rows, missed = [], []
    for each in verified:
        name = f"{each.method}, {each.setup}" if len(found.setups) > 1 else each.method
        total = found.multiple * math.hypot(each.reached, bias[each.setup, each.method])
        difference = f"{100 * (each.predicted / each.reached - 1):+.0f} %"
        errors = f"{each.predicted:.2f}", f"{each.reached:.2f}", difference, f"{total:.2f}"
        rows.append((name, str(each.realizations), *errors))
        if total > found.precision:
            missed.append(
                f"{name} misses the wish: ± {total:.2f} with {each.realizations} realizations"
            )
    headings = ["method", "realizations", "predicted", "reached", "difference"]
    headings.append(f"± with bias,\nwish ± {found.precision:g}")
    if rows:
        show_table(f"random error (N·m/rad), {verified[0].trials} trials", headings, rows)
        say("\n".join(["difference: predicted over reached, less 1", *missed]))


def _number(value: float, text: str = "{:.1f}") -> str:
    return text.format(value) if math.isfinite(value) else "-"
