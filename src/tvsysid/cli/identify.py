"""`tvsysid identify`."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import attrs

from tvsysid.cli.console import (
    remark,
    say,
    say_written,
    show_table,
    shown_progress,
)
from tvsysid.cli.options import (
    SLOW_RATE,
    Flag,
    Methods,
    ReadingOptions,
    SegmentationOptions,
    rate_options,
)
from tvsysid.cli.running import command_line
from tvsysid.errors import InputError, printable
from tvsysid.recordings.reading import Reading, Segmentation

if TYPE_CHECKING:
    from tvsysid.comparison import Comparison, PreparedRecording
    from tvsysid.signals import Recording

MAX_TESTED_CHANNELS = 8
SCHEDULED_METHODS = ["lpv", "lpvkbi"]  # with a scheduling variable
NO_PERIOD = (
    "--period is missing: the duration of one repetition of the behaviour (s); for a joint that is "
    "held still, any will do (--period 2); where nothing repeats, give the channel with a variable "
    "that the joint follows (--scheduling)"
)
IMPEDANCE = {  # names and formats, by heading
    "method": "method",
    "mean": "stiffness (N·m/rad):.1f",
    "±\n95 %": "half_band (N·m/rad):.1f",
    "±\nmethods": "between:.1f",
    "lowest": "lowest (N·m/rad):.1f",
    "at\n(s)": "lowest at (s):.2f",
    "highest": "highest (N·m/rad):.1f",
    "at\n(s) ": "highest at (s):.2f",
    "inertia": "inertia (kg·m²):.4f",
    "VAF": "VAF (%):.1f",
    "held\nout": "held out:.1f",
}
FURTHER = {
    "method": "method",
    "quantity": "quantity",
    "unit": "unit",
    "over": "over",
    "mean": "mean:.4g",
    "± 95 %": "half_band:.3g",
    "lowest": "lowest:.4g",
    "highest": "highest:.4g",
}


def identify(
    file: Path,
    /,
    *,
    reading: ReadingOptions = Reading(),
    segmentation: SegmentationOptions = Segmentation(),
    scheduling: str | None = None,
    method: Methods | None = None,
    align_channels: bool = True,
    remove_mains: bool = True,
    tune: Flag = False,
    sheet: Flag = False,
    out: Path = Path("tvsysid-identify"),
) -> int:
    """Identify stiffness over time from a recording.

    Reads angle and torque (`tvsysid inspect FILE` shows the names in a file), decimates them, cuts
    the recording into realizations of one period, subtracts the mean over realizations, and
    identifies by each method: by default `adaptive`, which has no settings and is recommended, and
    another to check it (`sds`, or `cascade` where there is a reflex or few realizations). `--method
    published` is the five of van de Ruit et al. (2021), `--method all` every one that applies.
    Where the data make every stiffness wrong, none is stated, and the first lines say why and what
    to do.

    A 95 % band covers measurement noise. It does not cover the error of a method that smooths too
    much. The band of `adaptive` also covers how fast stiffness may change, and when it may switch.

    VAF is the share of the recorded torque's variance that the model predicts. It is computed from
    the data that the model was identified from, so a method with many parameters has a high VAF
    even where its stiffness is mostly noise. Compare methods by the VAF of held-out realizations:
    these are split into five consecutive parts, and the model of four parts predicts the fifth.

    A method that needs a further channel (EMG, a reference signal, a scheduling variable) gets it
    by `--channel`. An input or a reference loses its mean as angle and torque do; a scheduling
    variable keeps it. A method that does not suit the recording is skipped, and the reason is
    printed. If a method fails, the others finish, and the exit code is 1.

    A joint that follows a measured variable needs no period. With `--scheduling` and without
    `--period`, all of the record is one realization, and `--decimate` takes a sharper filter. The
    variable is read under the name `scheduling`.

    A torque that is late or early, as found by `tvsysid inspect --diagnose`, is shifted before
    decimation. Half of the delay or none of it is corrected where that predicts held-out
    realizations better. A line and the figure's title say what was corrected; `models.nc` has it as
    `delay_removed` (in s). `--no-align-channels` corrects nothing.

    Realizations with a gap, where both signals were held, zero or interpolated for 30 ms or more,
    are left out. Mains hum that shows in the angle is subtracted from all channels before
    decimation. A line says so.

    Writes to the folder:

    - `report.html`: all of it on one page: the stiffness to report with its band, how it was found,
      what is wrong with the data and what to do, the methods side by side and why they differ, and
      a methods paragraph with references (BibTeX) for a paper;

    - with `--sheet`, `sheet.html`: one page of A4 about one person and visit; `tvsysid report DIR
      DIR … --sheet` makes one of several visits;

    - `stiffness.csv`: time_s, method, stiffness (N·m/rad), viscosity (N·m·s/rad) and inertia
      (kg·m²), each with its 95 % band (`stiffness_lower`, `stiffness_upper`, …), and
      time_varying_vaf (%); a further quantity that a method estimates over time has columns of the
      same kind;

    - `models.nc`: a group for each method with its estimates, their standard errors and bands, and
      the torque of each pathway (NetCDF; `xarray.open_datatree` reads it);

    - `stiffness.png` and `.pdf`: stiffness, viscosity and inertia over time, with their bands;

    - where something is estimated over a variable, `scheduled.csv` (method, variable, value,
      quantity, unit, estimate and 95 % band), and `scheduled.png` and `.pdf` with a histogram of
      the variable;

    - with `--tune`, `tuning.csv`, `.png` and `.pdf`: the settings that were tried, and how well
      each did.

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --period
    2 --torque-sign -1`

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --period
    2 --channel emg=EMG_SOL --method mymethod:Scheduled`

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --period
    2 --channel command=CMD --method kbr:reference=command,weighting=residual` (a compliant
    actuator)

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100
    --scheduling ankle_angle`

    Parameters
    ----------
    file
        MAT, CSV, TSV, NPZ, HDF5, NetCDF, NWB, Motion-BIDS, Parquet, C3D or EDF file.
    scheduling
        Channel with a variable that the joint follows; the methods are then lpv and lpvkbi unless
        given. Without --period, all of the record is one realization.
    align_channels
        Correct a delay of the torque, unless that lowers the held-out VAF.
    remove_mains
        Subtract mains hum (50 or 60 Hz) that shows in the angle.
    tune
        Choose each method's settings from the data.
    sheet
        Also write `sheet.html`, one page of A4 to print, for research use only.
    out
        Folder for the results.
    """
    from tvsysid.comparison import compare, prepare_recording
    from tvsysid.methods import centered_channels, expand, parse
    from tvsysid.recordings import read_recording
    from tvsysid.report import write_folder

    if scheduling is not None:
        channels = {**reading.channels, "scheduling": scheduling}
        reading = attrs.evolve(reading, channels=channels)
        method = method or SCHEDULED_METHODS
    method = method or []
    recording = read_recording(file, reading)
    if scheduling is None and segmentation.period is None:
        raise InputError(NO_PERIOD)
    out.mkdir(parents=True, exist_ok=True)
    rate = recording.sampling_rate
    if segmentation.decimate is None and rate > SLOW_RATE:
        remark("note", f"at {rate:g} Hz this takes minutes; seconds with {rate_options(rate)}")
    prepared = prepare_recording(
        recording,
        segmentation,
        centered_channels(map(parse, expand(method))),
        align_channels=align_channels,
        remove_mains=remove_mains,
    )
    for note in prepared.notes:
        say(note)
    say(f"{file.name}: {prepared.ensemble!r}")
    with shown_progress("identifying") as advance:
        found = compare(prepared.ensemble, method, tune=tune, progress=advance)
    for label, reason in found.skipped.items():
        remark("warning", f"{label} is skipped: {reason}")
    for label, reason in found.failed.items():
        remark("error", f"{label} failed: {reason}")
    found, source = _judged(found, prepared, recording, file, reading), _source(file, reading)
    written = write_folder(out, found, source, prepared.corrections, command_line(), sheet)
    _show_impedance(found)
    _show_diagnosis(found)
    _show_settings(found)
    say_written(out, written)
    return int(bool(found.failed))


def _judged(
    found: Comparison,
    prepared: PreparedRecording,
    recording: Recording,
    file: Path,
    reading: Reading,
) -> Comparison:
    """Predict held-out realizations, diagnose the data, and look for unnamed references."""
    with shown_progress("predicting held-out realizations") as advance:
        held_out = found.held_out_vaf(progress=advance)
    return attrs.evolve(
        found,
        held_out=held_out,
        diagnosis=prepared.diagnose(found.inputs.get("reference")),
        unnamed_references=tuple(_unnamed_references(found, recording, file, reading)),
    )


def _source(file: Path, reading: Reading) -> dict[str, str]:
    sign = ", sign reversed" if reading.torque_sign == -1 else ""
    return {
        "file": printable(file.name),
        "angle": f"channel {reading.angle}, in {reading.angle_unit}",
        "torque": f"channel {reading.torque}, in {reading.torque_unit.replace('N', 'N·')}{sign}",
    }


def _unnamed_references(
    found: Comparison, recording: Recording, file: Path, reading: Reading
) -> Iterator[str]:
    """Yield a sentence for each channel of the file that was not read and drives the angle.

    Nothing is tested where a method has a reference or a scheduling variable.
    """
    from tvsysid.preprocess import segment, subtract_mean
    from tvsysid.recommendation import find_unnamed_references
    from tvsysid.recordings import describe_file

    if found.inputs.keys() & {"reference", "scheduling"}:
        return
    channels, ensemble = describe_file(file), found.ensemble
    shape, named = channels[reading.names["angle"]].shape, {*reading.names.values()}
    others = [name for name in channels if name not in named and channels[name].shape == shape]
    for name in others[:MAX_TESTED_CHANNELS]:
        with suppress(InputError):  # it holds no numbers
            values = channels[name].read(name).ravel(order="F")
            with_channel = attrs.evolve(recording, channels={name: values})
            context = ensemble.context / ensemble.sampling_rate
            cut = subtract_mean(segment(with_channel, ensemble.duration, context), [name])
            for sentence in find_unnamed_references(cut, [name]):
                yield sentence.replace("--method", f"--channel {name}={name} --method")


def _show_impedance(found: Comparison) -> None:
    """Print the answer, a row for each method, and what else they estimate."""
    from tvsysid.report.estimates import further

    answer = found.answer
    say("\n  ".join(answer.lines))
    table = found.summary()
    table["held out"] = table.method.map(answer.vaf)
    table["between"] = table.method.map({answer.label: answer.difference})
    title = "stiffness with its band and extremes (N·m/rad), inertia (kg·m²), VAF (%)"
    validity = "" if answer.is_stated else "not valid: "
    show_table(validity + title, table.to_dict("records"), IMPEDANCE)
    show_table("further estimates", further(found).to_dict("records"), FURTHER)


def _show_diagnosis(found: Comparison) -> None:
    """Print the findings of the diagnosis."""
    diagnosis = found.recommendation.diagnosis
    if isinstance(diagnosis, str):
        say(f"diagnosis: none: {diagnosis}")
        return
    for text in diagnosis.remarks:
        remark("note", text)
    names = ", ".join(each.name for each in diagnosis.findings)
    advice = f": {names} (report.html says what to do)" if names else ""
    say(f"diagnosis: {diagnosis.verdict}{advice}")


def _show_settings(found: Comparison) -> None:
    """Print which settings were chosen from the data, and the options that repeat them."""
    from tvsysid.methods import to_text

    options = []
    for label, evidence in found.evidence.items():
        say(f"{label}: {evidence}")
        options += ["--method", to_text(found.methods[label])]
    if options:
        say(f"the same settings again: {shlex.join(options)}")
