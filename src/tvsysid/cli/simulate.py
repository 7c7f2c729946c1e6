"""`tvsysid simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tvsysid.cli.console import say
from tvsysid.cli.options import Perturbation, Profile
from tvsysid.errors import InputError


def simulate(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write: .mat, .csv or .tsv.")],
    stiffness: Annotated[Profile, typer.Option(help="Stiffness profile.")] = Profile.square,
    perturbation: Annotated[Perturbation, typer.Option(help="Angular perturbation.")] = Perturbation.noise,
    duration: Annotated[float, typer.Option(metavar="S", help="Seconds of data.")] = 150.0,
    snr: Annotated[
        float, typer.Option("--snr", metavar="DB", help="Signal-to-noise ratio of the torque in dB; inf for no noise.")
    ] = 10.0,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed.")] = 0,
    rate: Annotated[float, typer.Option(metavar="HZ", help="Sampling rate.")] = 1000.0,
    participant: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Write the ten trials of the virtual participant with this number instead, to a .mat file that "
            "`tvsysid experiment` reads; of the options, --perturbation alone applies.",
        ),
    ] = None,
) -> None:
    """Write a simulated recording that `tvsysid identify` reads, or a virtual participant's trials.

    The file holds `angle` (rad), `torque` (N·m, with noise), and the truth: `noiseless_torque` (N·m) and
    `stiffness` (N·m/rad). The behaviour repeats every 2 s. A participant's file has a column for each trial of 70 s at
    1024 Hz, and besides `target` (N·m), the torque to be followed.

    Example: `tvsysid simulate joint.mat && tvsysid identify joint.mat --angle angle --torque torque --rate 1000
    --decimate 100 --period 2`

    Example: `tvsysid simulate P1-noise.mat --participant 1`
    """
    from tvsysid.recordings import write_simulation
    from tvsysid.simulate import PERTURBATIONS, PROFILES, Joint

    if participant is not None:
        _write_participant(file, participant, perturbation.value)
        return
    simulation = Joint(stiffness=PROFILES[stiffness.value]).simulate(
        duration, perturbation=PERTURBATIONS[perturbation.value], snr_db=snr, seed=seed, rate=rate
    )
    recording = simulation.recording
    first = round(-recording.start * rate)
    inner = slice(first, first + round(duration * rate))
    columns = {
        "angle": recording.angle[inner],
        "torque": recording.torque[inner],
        "noiseless_torque": simulation.noiseless.torque[inner],
        "stiffness": simulation.truth["stiffness"][inner],
    }
    write_simulation(file, columns, rate)
    decimate = " --decimate 100" if rate > 100 and rate % 100 == 0 else ""
    say(
        f"wrote {file}: {duration:g} s at {rate:g} Hz; identify it with\n"
        f"tvsysid identify {file} --angle angle --torque torque --rate {rate:g}{decimate} --period 2",
    )


def _write_participant(file: Path, number: int, perturbation: str) -> None:
    from tvsysid.recordings import write_simulation
    from tvsysid.simulate import PERTURBATIONS, Participant

    if file.suffix.lower() != ".mat":
        raise InputError(f"{file}: a participant's trials are matrices; give a file that ends in .mat")
    simulation = Participant(number).simulate(perturbation=PERTURBATIONS[perturbation])
    recording = simulation.recording
    signals = {
        "angle": recording.angle,
        "torque": recording.torque,
        "target": recording.channels["target"],
        "stiffness": simulation.truth["stiffness"],
    }
    count = len(recording.trials)
    columns = {name: values.reshape(count, -1).T for name, values in signals.items()}
    write_simulation(file, columns, recording.sampling_rate)
    say(
        f"wrote {file}: angle, torque, target and the true stiffness, {count} trials of "
        f"{recording.duration / count:g} s at {recording.sampling_rate:g} Hz, a column each; a study of it:\n"
        f'\n[participants.P{number}]\n{perturbation} = "{file}"\n\n[reading]\nangle = "angle"\ntorque = "torque"\n'
        f'sampling_rate = {recording.sampling_rate:g}\ncolumns = "trials"\n',
    )
