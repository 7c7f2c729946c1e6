"""`tvsysid plan`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.cli.console import progress, say, say_written, show_records, shown_warnings
from tvsysid.cli.options import Cutting, Flag, Methods, ReadingOptions, given
from tvsysid.cli.running import make_folder
from tvsysid.errors import InputError
from tvsysid.recordings.reading import Reading, Segmentation

if TYPE_CHECKING:
    from tvsysid.planning import Pilot, Plan
    from tvsysid.planning.setups import Setup
    from tvsysid.signals import Recording

MIN_REALIZATIONS = 20  # with fewer, plans and bands are the best case
LARGE_EXCESS = 1.1  # ratio of pilot and simulated scatter that is printed
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
    segmentation: Cutting = Segmentation(),
    verify: Flag = False,
    seed: int = 0,
    out: Path = Path("tvsysid-plan"),
) -> None:
    """Plan how much to record for a given precision of the stiffness.

    Simulates ensembles of 5, 10, 20, … realizations of a stated joint and protocol, or of what a
    pilot recording shows, and identifies them by each method. How far its stiffness scatters, and
    how far it is off in the mean, says how many realizations it needs. A second simulation, of a
    joint whose stiffness steps, says how fast a change each method can follow.

    Prints the shortest recording that suffices, and for each method: realizations, how long to
    record (with those at both ends that lack context), half the width of the 95 % band that they
    give, bias (which no band counts), and the time in which it follows a step. Where no number
    suffices, it says why. Writes `plan.png` and `plan.csv` to the folder. Without `--period`, a
    realization takes 2 s, and without `--decimate`, simulated data have 100 Hz.

    Example: `tvsysid plan --precision 5 --perturbation noise --perturbation prbs --amplitude 0.01
    --noise 0.3`

    Example: `tvsysid plan --precision 3 --resolution 0.05 --pilot pilot.mat --angle pos --torque
    tq --rate 1000 --decimate 100 --period 2`

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
        In place of --noise: signal-to-noise ratio in dB at an amplitude of 0.0087 rad. [10]
    pilot
        Recording to take joint, noise and perturbation from. Needs --angle, --torque, --rate.
    verify
        Simulate each answer anew, 40 times, and print predicted and reached error.
    seed
        Seed of the random numbers.
    out
        Folder for the results.
    """
    import tvsysid
    from tvsysid.figures import save
    from tvsysid.planning import Protocol
    from tvsysid.recordings import whole_file
    from tvsysid.validators import with_settings

    joint = given(system=system, stiffness=stiffness, noise=noise, snr_db=snr)
    if pilot is not None and joint:
        raise InputError(
            f"--pilot {pilot}: the pilot shows system, stiffness and noise; leave out --system, "
            "--stiffness, --noise and --snr"
        )
    if pilot is not None:
        with shown_warnings():
            first: Setup = _pilot(reading.read(pilot), segmentation)
    elif reading != Reading():
        raise InputError(
            "options that describe a recording (such as --angle and --rate) need --pilot FILE"
        )
    elif noise is not None and snr is not None:
        raise InputError("--noise and --snr: give one of them")
    else:
        cutting = given(period=segmentation.period, rate=segmentation.decimate)
        first = Protocol(**joint, **cutting)
    setups = [
        with_settings(first, perturbation=name, amplitude=size)
        for name in perturbation or (first.perturbation,)
        for size in amplitude or (first.amplitude,)
    ]
    make_folder(out)
    with progress("planning") as advance:
        found = tvsysid.plan(setups, precision, resolution, method, seed=seed, progress=advance)
    _show(found)
    with whole_file(out / "plan.csv") as file:
        found.table().to_csv(file, index=False, float_format="%.6g")
    save(found.plot(), out / "plan.png")
    say_written(out, ["plan.csv", "plan.png"])
    if verify:
        _verify(found)


def _pilot(recording: Recording, segmentation: Segmentation) -> Pilot:
    """Return what a pilot recording shows of joint, noise and perturbation, and print it."""
    from tvsysid import preprocess
    from tvsysid.planning import Pilot

    if segmentation.decimate is not None:
        recording = preprocess.decimate(recording, segmentation.decimate)
    cut = preprocess.segment(recording, segmentation.period or PERIOD_S, segmentation.context)
    pilot = Pilot.of(preprocess.subtract_mean(cut))
    say(f"pilot: {pilot.described()}")
    return pilot


def _show(found: Plan) -> None:
    """Print the answer, for each setup a row for each method, and why some do not suffice."""
    say(str(found), "bold")
    if found.best and (found.best.realizations or 0) < MIN_REALIZATIONS:
        say(
            f"with fewer than {MIN_REALIZATIONS} realizations this is the best case: record "
            f"{MIN_REALIZATIONS}"
        )
    columns = {
        "method": "{method}",
        "realizations": "{realizations}{star}",
        "record": "{duration}",
        "± reached": "{half_width:.1f}",
        "bias": "{bias:.1f}",
        "follows a\nstep in": "{rise_time:.2f} s",
    }
    for setup in found.setups:
        answers = [each for each in found.answers if each.setup == setup]
        records = [
            {
                **each._asdict(),
                "realizations": each.realizations or "none",
                "star": " *" if each.why else "",
                "duration": each.duration if each.realizations else None,
            }
            for each in answers
        ]
        show_records(setup, records, columns)
        for each in answers:
            if each.why:
                say(f"  * {each.method} does not suffice: {each.why}")
            if each.excess > LARGE_EXCESS:
                say(
                    f"  {each.method}: the pilot's scatter is {each.excess:.2g} times the "
                    "simulated one; the plan allows for it"
                )
    say("± reached: half the 95 % band that so many realizations give; bias is not in it (N·m/rad)")


def _verify(found: Plan) -> None:
    """Simulate the planned recordings, and print their errors."""
    with progress("verifying") as advance:
        verified = found.verify(progress=advance)
    bias = {(each.setup, each.method): each.bias for each in found.answers}
    records = []
    for each in verified:
        name = f"{each.method}, {each.setup}" if len(found.setups) > 1 else each.method
        total = found.multiple * math.hypot(each.reached, bias[each.setup, each.method])
        difference = 100 * (each.predicted / each.reached - 1)
        records.append({**each._asdict(), "name": name, "difference": difference, "total": total})
    columns = {
        "method": "{name}",
        "realizations": "{realizations}",
        "predicted": "{predicted:.2f}",
        "reached": "{reached:.2f}",
        "difference": "{difference:+.0f} %",
        f"± with bias,\nwish ± {found.precision:g}": "{total:.2f}",
    }
    if records:
        show_records(f"random error (N·m/rad), {verified[0].trials} trials", records, columns)
        say("difference: predicted over reached, less 1")
