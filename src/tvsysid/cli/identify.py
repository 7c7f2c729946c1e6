"""Implement the command `tvsysid identify`."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import attrs

from tvsysid.cli.console import (
    remark,
    say,
    say_written,
    show_table,
    shown_progress,
    warnings_last,
)
from tvsysid.cli.options import (
    SLOW_RATE,
    Flag,
    Flattened,
    Methods,
    ReadingOptions,
    SegmentationOptions,
    rate_options,
    suggested_options,
)
from tvsysid.cli.running import command_line
from tvsysid.errors import InputError
from tvsysid.recordings.reading import Reading, Segmentation

if TYPE_CHECKING:
    from tvsysid.comparison import Comparison

SCHEDULED_METHODS = ["lpv", "lpvkbi"]  # with a scheduling variable
ABOUT_PERIOD = (
    " SECONDS is the duration of one repetition of the movement. For a joint that is held still, "
    "any duration will do (--period 2). If nothing repeats, name the channel of a variable that "
    "the stiffness depends on instead (--scheduling CHANNEL)."
)
RECORDING_COLUMNS = {
    "recording": "recording",
    "method": "method",
    "stiffness\n(N·m/rad)": "stiffness (N·m/rad)",
    "VAF\n(%)": "VAF (%)",
    "faults": "faults of the data",
}


@attrs.frozen
class Options:
    """Settings of an identification.

    Parameters
    ----------
    align_channels
        Correct a delay of the torque, unless that lowers the held-out VAF.
    tune
        Choose each method's settings from the data.
    sheet
        Also write one page of A4 to print. For research use only.
    """

    method: Methods | None = None
    align_channels: bool = True
    tune: Flag = False
    sheet: Flag = False


def identify(
    file: Path,
    /,
    *files: Path,
    reading: ReadingOptions = Reading(),
    segmentation: SegmentationOptions = Segmentation(),
    scheduling: str | None = None,
    options: Annotated[Options, Flattened] = Options(),
    out: Path = Path("tvsysid-identify"),
) -> int:
    """Identify stiffness over time from a recording.

    Prints the recommended stiffness with its 95 % band, or why none can be stated. Writes a page,
    tables, models and figures to a folder. See docs/identify.md. `tvsysid inspect FILE` lists the
    channels, and saves these options.

    Example: `tvsysid identify ankle.mat --angle angle --torque torque --rate 1000 --decimate 100
    --period 2`

    Parameters
    ----------
    file
        Recording, or folder of recordings. Formats: MAT, CSV, NPZ, HDF5, NetCDF, NWB, Motion-BIDS,
        Parquet, C3D, EDF.
    files
        Further recordings, with the same options. Each gets a folder, and a row in one page.
    scheduling
        Channel that the stiffness depends on, for lpv and lpvkbi. Needs no --period.
    out
        Folder for the results.
    """
    from tvsysid.recordings import recordings_in

    if scheduling is not None:
        channels = {**reading.channels, "scheduling": scheduling}
        reading = attrs.evolve(reading, channels=channels)
        options = attrs.evolve(options, method=options.method or SCHEDULED_METHODS)
    identify_one = partial(
        _identify_one, reading=reading, segmentation=segmentation, options=options
    )
    recordings = recordings_in([file, *files])
    if recordings == [file]:
        return identify_one(file, out)
    return _identify_all(identify_one, recordings, out)


def _identify_all(
    identify_one: Callable[[Path, Path], int], recordings: Sequence[Path], out: Path
) -> int:
    """Identify each recording into its own folder, and write one page about all recordings."""
    from tvsysid.report import write_recordings

    if len({each.name for each in recordings}) < max(len(recordings), 1):
        raise InputError("found no recordings, or two files with the same name; rename one")
    code, folders = 0, []
    for file in recordings:
        say(f"\n{file.name}", "bold")
        try:
            code |= identify_one(file, out / file.name)
            folders.append(out / file.name)
        except InputError as error:
            code = 1
            remark("error", str(error))
    if not folders:
        return 2
    table = write_recordings(out / "report.html", folders, command_line())
    show_table("recordings", table.to_dict("records"), RECORDING_COLUMNS)
    say_written(out, ["report.html"])
    return code


def _identify_one(
    file: Path, out: Path, reading: Reading, segmentation: Segmentation, options: Options
) -> int:
    """Identify one recording, write its folder, print the answer, and return the exit code."""
    from tvsysid.comparison import compare, prepare
    from tvsysid.recordings import describe_file
    from tvsysid.report import write_folder

    missing = reading.missing
    if segmentation.period is None and "scheduling" not in reading.channels:
        missing.append("period")
    if missing:
        suggested = suggested_options(describe_file(file))
        needed = " ".join(suggested[name] for name in missing)
        about = ABOUT_PERIOD if "period" in missing else ""
        raise InputError(
            f"missing: {', '.join(missing)}; add {needed}. Capitals stand for what the file does "
            f"not state; `tvsysid inspect FILE` lists its channels.{about}"
        )
    rate = reading.sampling_rate or 0.0
    if segmentation.decimate is None and rate > SLOW_RATE:
        remark(
            "note", f"at {rate:g} Hz this takes minutes; decimated ({rate_options(rate)}), seconds"
        )
    with warnings_last():
        prepared = prepare(
            file,
            **attrs.asdict(reading),
            **attrs.asdict(segmentation),
            align_channels=options.align_channels,
        )
        out.mkdir(parents=True, exist_ok=True)
        with shown_progress("identifying") as advance:
            found = compare(prepared, options.method or [], tune=options.tune, progress=advance)
        with shown_progress("predicting held-out realizations") as advance:
            found = attrs.evolve(found, held_out=found.predict_held_out(progress=advance))
        written = write_folder(out, found, prepared, command_line(), options.sheet)
        say(repr(found))
        for correction in prepared.corrections:
            say(str(correction))
        _show_diagnosis(found)
        _show_settings(found)
        say_written(out, written)
    return int(bool(found.failed))


def _show_diagnosis(comparison: Comparison) -> None:
    """Print the findings of the diagnosis."""
    diagnosis = comparison.recommendation.diagnosis
    if isinstance(diagnosis, str):
        say(f"no diagnosis: {diagnosis}")
        return
    names = ", ".join(each.name for each in diagnosis.findings)
    advice = f": {names} (report.html says what to do)" if names else ""
    say(f"diagnosis: {diagnosis.verdict}, at {comparison.ensemble.sampling_rate:g} Hz{advice}")


def _show_settings(comparison: Comparison) -> None:
    """Print the settings that were chosen from the data, and the options to repeat them."""
    from tvsysid.methods import to_text

    options = []
    for label, evidence in comparison.evidence.items():
        say(f"{label}: {evidence}")
        options += ["--method", to_text(comparison.methods[label])]
    if options:
        say(f"to repeat these settings: {shlex.join(options)}")
