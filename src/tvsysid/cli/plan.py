"""`tvsysid plan`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import attrs

from tvsysid.cli.console import say, say_written, show_table, shown_progress
from tvsysid.cli.options import Methods, ReadingOptions, SegmentationOptions, given
from tvsysid.errors import InputError
from tvsysid.recordings.reading import Reading, Segmentation

if TYPE_CHECKING:
    from tvsysid.planning import Plan, Protocol

MAX_EXCESS = 1.25  # of the scatter in a pilot, which is not mentioned
PERIOD_S = 2.0


def plan(
    *,
    precision: float = 5.0,
    resolution: float | None = None,
    method: Methods = ["adaptive", "sds", "birf", "kbr"],
    perturbation: list[str] | None = None,
    amplitude: list[float] | None = None,
    system: str | None = None,
    stiffness: str | None = None,
    noise: float | None = None,
    snr: float | None = None,
    pilot: Path | None = None,
    reading: ReadingOptions = Reading(),
    segmentation: SegmentationOptions = Segmentation(),
    seed: int = 0,
    out: Path = Path("tvsysid-plan"),
) -> None:
    """Plan how much to record for a given precision of the stiffness.

    Simulates ensembles of 10 to 160 realizations of a stated joint and protocol, or of what a
    pilot recording shows, and identifies them by each method. The random error and the bias of its
    stiffness decide how many realizations a method needs. A second simulation, of a joint whose
    stiffness steps, says how fast a change each method can follow.

    Prints the shortest recording that suffices, and for each method: realizations, how long to
    record (with those at both ends, which are left out), the error (± at 95 %) by noise, by bias
    and by both, and the time in which it follows a step. No band counts the bias. Where no number
    suffices, it says why. Writes `plan.png` and `plan.csv` to the folder. Without `--period`, a
    realization takes 2 s, and without `--decimate`, simulated data have 100 Hz.

    Example: `tvsysid plan --precision 5 --perturbation noise --perturbation prbs --amplitude 0.01
    --noise 0.3`

    Example: `tvsysid plan --precision 3 --resolution 0.05 --pilot pilot.mat --angle angle
    --torque torque --rate 1000 --decimate 100 --period 2`

    Parameters
    ----------
    precision
        Stiffness is to be known to ± this at 95 % in N·m/rad, bias included.
    resolution
        A step is to be followed within this time in s (10 to 90 %). [any]
    perturbation
        Perturbation, as of `tvsysid simulate`; repeatable, to compare. [noise; with --pilot that of
        the pilot]
    amplitude
        RMS of the angle in rad; repeatable, to compare. [0.0087, half a degree; with --pilot the
        pilot's]
    system
        What is recorded, as of `tvsysid simulate`. [joint]
    stiffness
        Its stiffness over a realization. [sine]
    noise
        RMS of the torque's noise in N·m, whatever the amplitude.
    snr
        In place of --noise: signal-to-noise ratio in dB at an amplitude of 0.0087 rad, after
        decimation. [10]
    pilot
        Recording to take joint, noise and perturbation from. Needs --angle, --torque, --rate.
    seed
        Seed of the random numbers.
    out
        Folder for the results.
    """
    import tvsysid
    from tvsysid.figures import save
    from tvsysid.planning import Protocol
    from tvsysid.recordings import write_table
    from tvsysid.validators import with_settings

    joint = given(system=system, stiffness=stiffness, noise=noise, snr_db=snr)
    if pilot is None:
        if reading != Reading():
            raise InputError(
                "options that describe a recording (such as --angle and --rate) need --pilot FILE"
            )
        first = Protocol(**joint, **given(period=segmentation.period, rate=segmentation.decimate))
    elif joint:
        raise InputError(
            f"--pilot {pilot}: the pilot shows system, stiffness and noise; leave out --system, "
            "--stiffness, --noise and --snr"
        )
    else:
        first = _pilot(pilot, reading, segmentation)
    setups = [
        with_settings(first, perturbation=name, amplitude=size)
        for name in perturbation or (first.perturbation,)
        for size in amplitude or (first.amplitude,)
    ]
    out.mkdir(parents=True, exist_ok=True)
    with shown_progress("planning") as advance:
        found = tvsysid.plan(setups, precision, resolution, method, seed=seed, progress=advance)
    _show(found)
    write_table(out / "plan.csv", found.table())
    save(found.plot(), out / "plan.png")
    say_written(out, ["plan.csv", "plan.png"])


def _pilot(file: Path, reading: Reading, segmentation: Segmentation) -> Protocol:
    """Return what a pilot recording shows of joint, noise and perturbation, and print it."""
    from tvsysid.comparison import prepare
    from tvsysid.planning import Protocol

    cutting = attrs.evolve(segmentation, period=segmentation.period or PERIOD_S)
    prepared = prepare(file, **attrs.asdict(reading), **attrs.asdict(cutting))
    for correction in prepared.corrections:
        say(str(correction))
    for found in prepared.diagnose().findings:
        if found.fault.severity == "invalid":
            raise InputError(
                f"--pilot {file}: its stiffness is not valid: {found.what}; {found.fault.remedy}"
            )
    pilot = Protocol.of(prepared.ensemble)
    stiffness = pilot.stiffness_over_time
    say(
        f"pilot: stiffness by adaptive {stiffness.min():.1f} to {stiffness.max():.1f} N·m/rad; "
        f"noise of the torque {pilot.noise:.2g} N·m RMS"
    )
    return pilot


def _show(found: Plan) -> None:
    """Print the answer, a table of the methods for each setup, and why some do not suffice."""
    from tvsysid.planning.plans import COLUMNS

    say(str(found), "bold")
    columns = dict(list(COLUMNS.items())[1:-2])
    for setup, protocol in found.setups.items():
        rows = [each for each in found.required if each.setup == setup]
        show_table(setup, [each._asdict() for each in rows], columns)
        if any(each.realizations is None for each in rows):
            say(f"  -: no number suffices; the row is for {protocol.sizes[-1]} realizations")
        for each in rows:
            if each.why:
                say(f"  {each.method} does not suffice: {each.why}")
        ratios = [
            f"{each.method} {each.excess:.1f} times" for each in rows if each.excess > MAX_EXCESS
        ]
        if ratios:
            say(
                "  stiffness differs more between halves of the pilot than in simulations "
                f"({', '.join(ratios)}); ± noise includes this"
            )
    if all(each.pilot is None for each in found.setups.values()):
        say("assumed: pink noise of the torque, as voluntary torque is; --pilot measures yours")
    say(
        f"±: at 95 %, in N·m/rad; ± both is to be at most {found.precision:g}. ± noise "
        "includes differences between realizations. The band of `identify` does not; it covers "
        "errors in the speed of changes. Repeated recordings scatter by ± noise, not by that band"
    )
