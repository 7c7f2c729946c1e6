"""`tvsysid inspect`."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tvsysid.cli import options
from tvsysid.cli.console import remark, say, show_table, shown_warnings, waiting
from tvsysid.cli.identify import PIECES, USUAL_RATE, decimation
from tvsysid.cli.running import command_line
from tvsysid.errors import InputError

if TYPE_CHECKING:
    from tvsysid.quality import Diagnosis
    from tvsysid.recordings import Channel

MOST_DRAWN, MOST_COLUMNS = (
    12,
    20,
)  # channels of a file, and columns of a matrix, that are drawn at most


def inspect(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="MAT (any version, with structures, nldat or segdat objects), CSV or TSV, NPZ, "
            "HDF5, NetCDF, NWB, "
            "Motion-BIDS, Parquet (`tvsysid[parquet]`), C3D (`tvsysid[c3d]`), EDF or BDF "
            "(`tvsysid[edf]`).",
        ),
    ],
    plot: Annotated[
        Path | None,
        options.option(
            "FILE.png", "Picture to write: .png, .pdf or .svg. [tvsysid-inspect/FILE.png]"
        ),
    ] = None,
    diagnose: Annotated[
        bool,
        typer.Option(
            "--diagnose",
            metavar="",
            help="Also read the recording and cut it into realizations as `tvsysid identify` "
            "does, and report what is "
            "wrong with it. Needs --angle, --torque and --rate, and --period where the behaviour "
            "repeats.",
        ),
    ] = False,
    angle: Annotated[str | None, options.ANGLE] = None,
    torque: Annotated[str | None, options.TORQUE] = None,
    rate: Annotated[float | None, options.RATE] = None,
    period: Annotated[float | None, options.PERIOD] = None,
    decimate: Annotated[
        float | None,
        options.option("HZ", "Rate to which `tvsysid identify` will decimate; only checked here."),
    ] = None,
    channel: options.ChannelOption = [],
    reference: Annotated[
        str | None,
        options.option(
            "NAME",
            "Channel (of --channel) with the disturbance that was applied, to look for a closed "
            "loop.",
        ),
    ] = None,
    columns: options.ColumnsOption = "contiguous",
    torque_sign: options.TorqueSignOption = 1,
    angle_unit: options.AngleUnitOption = "rad",
    torque_unit: options.TorqueUnitOption = "Nm",
    header: options.HeaderOption = True,
    start: options.StartOption = 0.0,
    context: options.ContextOption = 0.5,
) -> None:
    """Show the channels of a file; with --diagnose, report what is wrong with the recording.

    Prints each channel's name, shape and type, and its unit and sampling rate if the file states
    them, and draws the signals: against time if the file states the rate, else against sample
    numbers. The names are those that the options `--angle`, `--torque` and `--channel` of `tvsysid
    identify` expect.

    With `--diagnose`, looks for faults that would spoil the result: units, signs, delays, lost or
    clipped signals, drift, misaligned realizations, a wrong period, feedback, reflexes. Prints what
    each fault does to the result and what to do, and which method suits the data (with `--period`),
    and writes a page with figures, `FILE.ANGLE-TORQUE.diagnosis.html`, beside the picture (ANGLE
    and TORQUE are the channels' names). The recording is diagnosed at its own rate, because
    decimation would hide some faults; `--decimate` is only checked. Without `--period` the record
    is cut into pieces of 2 s, and what concerns repetitions is not judged.

    Example: `tvsysid inspect ankle.mat`

    Example: `tvsysid inspect ankle.mat --plot ankle.pdf`

    Example: `tvsysid inspect ankle.mat --diagnose --angle pos --torque tq --rate 1000 --period 2`

    Example: `tvsysid inspect ankle.mat --diagnose --angle pos --torque tq --rate 1000 --period 2
    --channel command=CMD --reference command`
    """
    from tvsysid import preprocess
    from tvsysid.figures import recorded_channels, save
    from tvsysid.quality import diagnose as diagnosis_of
    from tvsysid.quality.resampling import lowered
    from tvsysid.recommendation import recommend
    from tvsysid.recordings import describe_file
    from tvsysid.report import write_diagnosis

    picture = plot or Path("tvsysid-inspect") / f"{file.name}.png"
    if picture.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise InputError(
            f"{picture}: unknown ending {picture.suffix!r}; give one of .png, .pdf, .svg"
        )
    needed = {"--angle": angle, "--torque": torque, "--rate": rate}
    missing = [name for name, value in needed.items() if value is None]
    if diagnose and missing:
        raise InputError(f"--diagnose needs {', '.join(missing)}, as for tvsysid identify")
    used = [name for name, value in {**needed, "--period": period}.items() if value is not None]
    if not diagnose and used:
        raise InputError(f"{used[0]}: is used with --diagnose only; add --diagnose")
    channels = describe_file(file, header)
    if reference is not None and reference not in {text.partition("=")[0] for text in channel}:
        raise InputError(
            f"--reference {reference}: no --channel is read under this name; add --channel "
            f"{reference}=CHANNEL, one of "
            f"{', '.join(channels)}"
        )
    _show_channels(file.name, channels)
    drawn = _outlines(channels)
    if drawn:
        save(recorded_channels(drawn, file.name), picture)
        say(f"wrote {picture}")
    else:
        say("no signals to draw")
    if angle is None or torque is None or rate is None:
        _show_next(file, channels)
        return
    if period is None:
        remark(
            "note",
            f"no --period: the record is cut into pieces of {PIECES:g} s, which are not taken to "
            "repeat",
        )
    with shown_warnings():
        recording = options.read(
            file,
            angle,
            torque,
            rate,
            columns,
            torque_sign,
            angle_unit,
            start,
            header,
            torque_unit,
            channel,
        )
        if decimate is not None:
            preprocess.decimate(recording, decimate)  # reports a rate that is impossible
        # Not decimated: that would hide a clipped signal. A check that needs a low rate decimates
        # by itself.
        known = [] if reference is None else [reference]
        cut = preprocess.segment(
            recording, period or PIECES, context, preprocess.find_gaps(recording)
        )
        ensemble = preprocess.subtract_mean(cut, known)
    with waiting("diagnosing"):
        diagnosis = diagnosis_of(
            ensemble, reference, repeats=period is not None, recording=recording
        )
        suited = (
            recommend(lowered(ensemble), reference, diagnosis=diagnosis)
            if period is not None
            else None
        )
    # A file may hold several pairs of channels: a page for each.
    page = picture.with_name(
        re.sub(r"[^\w.-]+", "_", f"{file.name}.{angle}-{torque}.diagnosis.html")
    )
    name = f"{file.name} ({angle}, {torque})"
    write_diagnosis(page, {name: diagnosis}, command_line())
    _print_diagnosis(diagnosis, name)
    if suited is not None:
        say(f"method for these data: {suited.sentence}")
    say(f"wrote {page}")


def _show_channels(name: str, channels: dict[str, Channel]) -> None:
    rows = []
    for label, channel in channels.items():
        stated = "-" if channel.sampling_rate is None else f"{channel.sampling_rate:g}"
        shape = " x ".join(map(str, channel.shape)) or "one value"
        rows.append((label, shape, channel.dtype, channel.unit or "-", stated))
    show_table(name, ["channel", "shape", "type", "unit", "rate (Hz)"], rows, "lrllr")


def _print_diagnosis(diagnosis: Diagnosis, name: str) -> None:
    say(f"{name}: {diagnosis.ensemble}: {diagnosis.verdict}")
    for check in diagnosis.findings:
        lines = (
            f"  seen:   {check.what}\n  effect: {check.fault.effect}\n  remedy: "
            f"{check.fault.remedy}"
        )
        say((check.name, "bold"), f" ({check.strength})\n{lines}")
    for line in diagnosis.notes:
        say(line)


def _outlines(channels: dict[str, Channel]) -> dict[str, Any]:
    """Outlines of the first signals of a file that fit in memory, and of the first columns of each."""
    import numpy as np

    from tvsysid.recordings import outline

    drawn: dict[str, Any] = {}
    signals = [
        name
        for name, channel in channels.items()
        if channel.values is not None
        and len(channel.shape) in (1, 2)
        and max(channel.shape) > 1
        and all(channel.shape)
    ]
    for name in signals:
        if len(drawn) == MOST_DRAWN:
            remark("note", f"{len(signals) - MOST_DRAWN} more channels are not drawn")
            break
        try:
            values = channels[name].read(name)
        except InputError as error:
            remark("note", f"not drawn: {error}")
            continue
        if not np.iscomplexobj(values):
            columns = (
                [values.ravel()]
                if min(values.shape) == 1 or values.ndim == 1
                else list(values.T[:MOST_COLUMNS])
            )
            drawn[name] = (
                channels[name],
                [outline(np.asarray(column, dtype=float)) for column in columns],
            )
    return drawn


def _show_next(file: Path, channels: dict[str, Channel]) -> None:
    """Print how the file is identified, at the rate that it states, decimated where that is usual."""
    stated = {each.sampling_rate for each in channels.values() if each.sampling_rate}
    rate = stated.pop() if len(stated) == 1 else None
    at = (
        f"HZ --decimate {USUAL_RATE:g}" if rate is None else f"{rate:g} {decimation(rate)}".rstrip()
    )
    words = f"--angle CHANNEL --torque CHANNEL --rate {at} --period SECONDS"
    say(f"identify it with\ntvsysid identify {shlex.quote(str(file))} {words}")
    if any(len(each.shape) == 2 and min(each.shape) > 1 for each in channels.values()):
        say("where each column of a matrix is a trial by itself, add --columns trials")
