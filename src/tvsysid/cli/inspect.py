"""Implement the command `tvsysid inspect`."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import attrs

from tvsysid.cli.console import errors, remark, say, show_table
from tvsysid.cli.options import Flag, ReadingOptions, SegmentationOptions, suggested_options
from tvsysid.cli.running import command_line
from tvsysid.errors import InputError
from tvsysid.recordings.reading import Reading, Segmentation

# Decimation would hide these faults.
SENSOR_CHECKS = {"clipped-torque", "clipped-angle", "lost-torque", "lost-angle"}
SENSOR_CHECKS |= {"torque-spikes", "angle-spikes"}


def inspect(
    file: Path,
    /,
    *,
    reading: ReadingOptions = Reading(),
    segmentation: SegmentationOptions = Segmentation(),
    save: Flag = False,
    diagnose: Flag = False,
    reference: str | None = None,
    out: Path = Path("tvsysid-inspect"),
) -> None:
    """Show the channels of a file; with --diagnose, report what is wrong with the recording.

    Prints each channel's name and shape, and its unit and sampling rate if the file states them.
    Draws the signals over time, or over sample numbers if the file states no rate. Give these names
    to the options `--angle`, `--torque` and `--channel` of `tvsysid identify`.

    With `--diagnose`, looks for faults that would spoil the result: units, signs, delays, lost or
    clipped signals, drift, misaligned realizations, a wrong period, feedback, reflexes. Prints the
    effect and the remedy of each fault and, with `--period`, which method suits the data. Writes a
    page with figures, `FILE.ANGLE-TORQUE.diagnosis.html`, beside the picture. ANGLE and TORQUE are
    the channels' names. The data are those that `tvsysid identify` identifies with these options;
    faults that it corrects are listed, too. Clipped and lost signals and spikes are looked for at
    the recorded rate. Without `--period`, the record is cut into pieces of 2 s, and repetitions are
    not checked.

    Example: `tvsysid inspect ankle.mat`

    Example: `tvsysid inspect ankle.mat --angle angle --torque torque --rate 1000 --period 2 --save`

    Example: `tvsysid inspect ankle.mat --diagnose --angle angle --torque torque --rate 1000
    --period 2 --channel command=CMD --reference command`

    Parameters
    ----------
    file
        MAT (any version, with structures, nldat or segdat objects), CSV or TSV, NPZ, HDF5, NetCDF,
        NWB, Motion-BIDS, Parquet (`tvsysid[parquet]`), C3D (`tvsysid[c3d]`), EDF or BDF
        (`tvsysid[edf]`).
    save
        Write the options to FILE.toml beside the file, where `identify`, `plan`, `inspect` and
        `explore` find them. Options on the command line override them.
    diagnose
        Also read the recording and cut it into realizations as `tvsysid identify` does, and report
        its faults. Needs --angle, --torque and --rate, and --period if the movement repeats.
    reference
        Name (given by --channel) of the applied disturbance, to look for a closed loop.
    out
        Folder for the picture and the page.
    """
    from tvsysid import figures
    from tvsysid.recordings import describe_file, read_recording
    from tvsysid.recordings.saved import save_settings

    channels = describe_file(file)
    picture = out / f"{file.name}.png"
    records = [{"name": name, "content": each.described} for name, each in channels.items()]
    show_table(file.name, records, {"channel": "name", "content": "content"})
    try:
        figures.save(figures.recorded_channels(channels, file.name), picture)
        say(f"wrote {picture}")
    except InputError as error:
        remark("note", str(error))
    if save:
        read_recording(file, reading)  # warns if the file contradicts the options
        settings = save_settings(file, reading, segmentation)
        say(f"wrote {settings}; identify with\ntvsysid identify {shlex.quote(str(file))}")
    if diagnose:
        _show_diagnosis(file, out, reading, segmentation, reference)
    elif not save:
        options = " ".join(suggested_options(channels).values())
        say(f"identify it with\ntvsysid identify {shlex.quote(str(file))} {options}")
        if any(len(each.shape) == 2 and min(each.shape) > 1 for each in channels.values()):
            say("if each column of a matrix is a separate trial, add --columns trials")


def _show_diagnosis(
    file: Path, folder: Path, reading: Reading, segmentation: Segmentation, reference: str | None
) -> None:
    """Diagnose a recording, print and write the findings, and recommend a method.

    The data are corrected as ``tvsysid identify`` does; faults that it corrects count as found. A
    method is recommended if the movement repeats.
    """
    from tvsysid.comparison import prepare
    from tvsysid.recommendation import recommend
    from tvsysid.report import write_diagnosis
    from tvsysid.report.diagnosis import recording_illustration

    repeats = segmentation.period is not None
    if not repeats:
        remark("note", "repetitions are not checked; if the movement repeats, add --period")
    with errors.status("diagnosing"):
        cutting = attrs.asdict(segmentation)
        prepared = prepare(file, **attrs.asdict(reading), **cutting)
        prepared = prepared.center([reference] if reference else [])
        diagnosis = prepared.diagnose(reference)
        cutting["decimate"] = None
        recorded = prepare(prepared.recording, **cutting, align_channels=False).diagnose()
        sensors = [each for each in recorded.checks if each.name in SENSOR_CHECKS]
        corrected = [fault for fault, _ in prepared.corrections]
        checks = {each.name: each for each in (*diagnosis.checks, *sensors, *corrected)}
        diagnosis = attrs.evolve(diagnosis, checks=tuple(checks.values()))
        # A file may hold several pairs of channels. Each pair has its own page.
        stem = re.sub(r"[^\w.-]+", "_", f"{file.name}.{reading.angle}-{reading.torque}")
        page = folder / f"{stem}.diagnosis.html"
        name = f"{file.name} ({reading.angle}, {reading.torque})"
        pictures = {name: recording_illustration(prepared.recording, prepared.ensemble)}
        write_diagnosis(page, {name: diagnosis}, command_line(), pictures)
        found = recommend(prepared.ensemble, reference, diagnosis=diagnosis) if repeats else None
    say(f"{name}: {diagnosis!r}")
    for correction in prepared.corrections:
        say(str(correction))
    if found:
        say(repr(found))
    say(f"wrote {page}")
