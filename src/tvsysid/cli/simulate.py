"""`tvsysid simulate`."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.cli.console import say
from tvsysid.cli.options import Flag, rate_options
from tvsysid.errors import InputError, describe_error

if TYPE_CHECKING:
    from tvsysid.signals import Array
    from tvsysid.simulate import Perturbation, Simulation, System

PERIOD_S = 2.0


def simulate(
    file: Path,
    /,
    *,
    system: str = "joint",
    stiffness: str | None = None,
    duration: float = 150.0,
    snr: float = 10.0,
    seed: int = 0,
    rate: float = 1000.0,
    perturbation: str = "noise",
    overwrite: Flag = False,
    participant: int | None = None,
) -> None:
    """Write a simulated recording for `tvsysid identify`, or the trials of a virtual participant.

    The file holds `angle` (rad), `torque` (N·m, with noise) and the system's further channels, such
    as `emg`. It also holds the truth: `noiseless_torque` (N·m), that of each pathway if there are
    several (`torque_reflex`), and `stiffness` (N·m/rad), `viscosity` (N·m·s/rad), `inertia` (kg·m²)
    and the system's other true quantities. The movement repeats every 2 s. The file of a
    participant has a column for each trial of 70 s at 1024 Hz, and `target` (N·m), the torque that
    the participant was asked to produce.

    Example: `tvsysid simulate joint.mat && tvsysid identify joint.mat --angle angle --torque torque
    --rate 1000 --decimate 100 --period 2`

    Example: `tvsysid simulate reflex.mat --system reflex-sine --stiffness sine --perturbation
    pulses`

    Example: `tvsysid simulate P1-noise.mat --participant 1`

    Parameters
    ----------
    file
        File to write: .mat, .csv or .tsv.
    system
        What is simulated: `joint`, `reflex` (a joint with a stretch reflex of constant gain;
        `reflex-sine`, `reflex-square`: of varying gain), `compliant` (a joint on a compliant
        actuator: closed loop; `loaded`: moved by a torque), `scheduled` (stiffness follows EMG), or
        your own as `module:Object`. Settings may follow:
        `reflex:reflex_gain=4,noise_bandwidth=1`.
    stiffness
        Stiffness over time: `square`, `sine`, `constant`, or your own function of time as
        `module:Object`. [that of the system: sine for scheduled, else square]
    duration
        Seconds of data.
    snr
        Signal-to-noise ratio of the torque in dB; inf for no noise.
    seed
        Seed of the random numbers.
    rate
        Sampling rate in Hz. Nothing is filtered: at a low rate, faster components alias into the
        torque (at 100 Hz inertia is found 44 % low). Simulate at 1000 Hz, and decimate.
    perturbation
        Perturbation of the angle: `noise` (low-pass filtered), `prbs` (pseudo-random binary
        sequence), `pulses` (to either side, with rests), `multisine` (sines at a few frequencies),
        or your own as `module:Object`.
    overwrite
        Replace FILE if it exists.
    participant
        Write the ten trials of virtual participant number N instead, to a .mat file that `tvsysid
        experiment` reads; of the other options only --perturbation applies to it.
    """
    from tvsysid.methods import resolve
    from tvsysid.recordings import write_simulation
    from tvsysid.simulate import PERTURBATIONS

    if file.exists() and not overwrite:
        raise InputError(f"{file} exists already; give another name, or --overwrite")
    perturbed = resolve(perturbation, PERTURBATIONS, "perturbation")
    if participant is not None:
        _write_participant(file, participant, perturbation, perturbed)
        return
    joint = _system(system, stiffness)
    try:
        simulation = joint.simulate(
            duration, perturbation=perturbed, snr_db=snr, seed=seed, rate=rate
        )
        signals = _signals(simulation)
    except Exception as error:  # a system of one's own may raise anything
        raise InputError(f"system {system}: {describe_error(error)}") from error
    first = round(-simulation.recording.start * rate)
    inner = slice(first, first + round(duration * rate))
    write_simulation(file, {name: each[inner] for name, each in signals.items()}, rate)
    period = getattr(getattr(joint, "stiffness", None), "period", PERIOD_S)
    channels = simulation.recording.channels
    named = "".join(f" --channel {name}={name}" for name in channels)
    say(
        f"wrote {file}: {duration:g} s at {rate:g} Hz; identify it with\ntvsysid identify "
        f"{shlex.quote(str(file))} --angle angle --torque torque {rate_options(rate)} --period "
        f"{period:g}{named}"
    )
    if "disturbance" in channels:
        say("in closed loop: add --method kbr:reference=disturbance,weighting=residual")
    if (variable := getattr(joint, "variable", None)) in channels:
        say(f"to identify stiffness as a function of {variable}: add --scheduling {variable}")


def _system(text: str, stiffness: str | None) -> System:
    """Return the system, with the stiffness if one is given."""
    from tvsysid.methods import resolve
    from tvsysid.simulate import PROFILES, SYSTEMS
    from tvsysid.validators import with_settings

    system: System = resolve(text, SYSTEMS, "system")
    if stiffness is None:
        return system
    try:
        return with_settings(system, stiffness=resolve(stiffness, PROFILES, "profile"))
    except TypeError as error:
        raise InputError(f"--stiffness: {text} has no setting stiffness; set it there") from error


def _write_participant(file: Path, number: int, name: str, perturbation: Perturbation) -> None:
    """Write the trials of a virtual participant, and print how a study reads them."""
    from tvsysid.recordings.write import checked, write_simulation
    from tvsysid.simulate import Participant

    checked(file, ".mat")  # the trials are matrices
    simulation = Participant(number).simulate(perturbation=perturbation)
    signals, recording = _signals(simulation), simulation.recording
    trials, rate = len(recording.trials), recording.sampling_rate
    names = ("angle", "torque", "target", "stiffness")
    columns = {each: signals[each].reshape(trials, -1).T for each in names}
    write_simulation(file, columns, rate)
    key = re.sub(r"\W", "-", name)
    say(
        f"wrote {file}: {', '.join(columns)}, {trials} trials of {recording.duration / trials:g} s "
        f"at {rate:g} Hz, a column each; to analyse it, put this into study.toml:\n\n"
        f'[participants.P{number}]\n{key} = "{file}"\n\n[reading]\nangle = "angle"\n'
        f'torque = "torque"\nsampling_rate = {rate:g}\ncolumns = "trials"\n\n'
        '[preparation]\nreference = "target"\nperiod = 2\n'
    )


def _signals(simulation: Simulation) -> dict[str, Array]:
    """Return recorded signals and truth, by their names in the file."""
    recording = simulation.recording
    pathways = simulation.pathways if len(simulation.pathways) > 1 else {}
    return {
        "angle": recording.angle,
        "torque": recording.torque,
        **recording.channels,
        "noiseless_torque": simulation.noiseless.torque,
        **{f"torque_{name}": torque for name, torque in pathways.items()},
        **simulation.truth,
    }
