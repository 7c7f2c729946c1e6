"""`tvsysid identify`."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tvsysid.cli import options
from tvsysid.cli.console import progress, remark, say, say_written, show_table, shown_warnings
from tvsysid.cli.running import check_folder
from tvsysid.errors import InputError
from tvsysid.limits import TIME_LIMIT

if TYPE_CHECKING:
    from tvsysid.comparison import Comparison
    from tvsysid.signals import Recording

DEFAULT_METHODS = ["adaptive", "eirf", "sds", "birf", "esm", "kbr"]  # of tvsysid.methods, which takes long to import
SCHEDULED_METHODS = ["lpv", "lpvkbi"]  # with a scheduling variable
PIECES = 2.0  # seconds of the realizations in which a delay is looked for where there is no period
SLOW_RATE = 250.0  # Hz from which on identifying without decimation takes minutes
REFLEX = {"delay": "s", "frequency": "rad/s", "damping": "", "threshold": "rad/s"}  # units of what shapes a reflex
EXPLAINED = {"vaf": "torque explained", "vaf_intrinsic": "by the intrinsic pathway", "vaf_reflex": "by the reflex"}
EXPLAINED |= {"vaf_held_out": "of realizations held out", "vaf_folds": "of five folds held out"}


def identify(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="MAT, CSV, TSV, NPZ, HDF5, NetCDF, Parquet or C3D file.")
    ],
    angle: Annotated[str, options.ANGLE],
    torque: Annotated[str, options.TORQUE],
    rate: Annotated[float, options.RATE],
    period: Annotated[float | None, options.PERIOD] = None,
    scheduling: Annotated[
        str | None,
        options.option(
            "CHANNEL",
            "Channel with a variable that the joint follows; the methods are then lpv and lpvkbi unless given. Without "
            "--period, all of the record is one realization.",
        ),
    ] = None,
    decimate: options.DecimateOption = None,
    channel: options.ChannelOption = [],
    columns: options.ColumnsOption = "contiguous",
    torque_sign: options.TorqueSignOption = 1,
    angle_unit: options.AngleUnitOption = "rad",
    start: options.StartOption = 0.0,
    context: options.ContextOption = 0.5,
    method: options.MethodOption = DEFAULT_METHODS,
    time_limit: options.TimeLimitOption = TIME_LIMIT,
    align_channels: Annotated[
        bool,
        options.option(
            "", "Estimate the delay between angle and torque, and correct it if it is significant.", "--align-channels"
        ),
    ] = False,
    tune: Annotated[bool, options.option("", "Choose each method's settings from the data.", "--tune")] = False,
    out: options.OutOption = Path("tvsysid-identify"),
) -> None:
    """Identify stiffness over time from a recording.

    Reads angle and torque (`tvsysid inspect FILE` shows the names in a file), decimates them, cuts the recording into
    realizations of one period, subtracts the mean over realizations, and identifies by each method: by default
    `adaptive`, which has no settings and whose stiffness is the one to go by, and five for comparison.

    A 95 % band accounts for noise only: it does not include the error of a method that smooths too much. That of
    `adaptive` counts how unsure it is of how fast stiffness changes, and when it switches.

    VAF is the share of the recorded torque's variance that the model predicts. It is computed from the data that the
    model was identified from, so a method with many parameters has a high VAF even where its stiffness is mostly noise.

    A method that needs a further channel (EMG, a reference signal, a scheduling variable) gets it by `--channel`. An
    input or a reference loses its mean as angle and torque do; a scheduling variable keeps it. A method that cannot
    serve the recording is skipped, and the reason is printed. One that fails spoils no other; the exit code is then 1.

    A joint that follows a measured variable needs no period: with `--scheduling` and without `--period`, all of the
    record is one realization, and `--decimate` takes a sharper filter, as torque beyond the new band counts more there.
    The variable is read under the name `scheduling`.

    With `--align-channels`, the delay of the torque is estimated as by `tvsysid inspect --diagnose`. One that is found
    is corrected before decimation, and printed with what it did to inertia and viscosity. The figure's title states
    it, and `delay_removed` (in s) in `models.nc`.

    Writes to the folder:

    - `stiffness.csv`: time_s, method, stiffness (N·m/rad), viscosity (N·m·s/rad) and inertia (kg·m²), each with its
    95 % band (`stiffness_lower`, `stiffness_upper`, …), and time_varying_vaf (%); a further quantity that a method
    estimates over time has columns of the same kind;

    - `models.nc`: a group for each method with its estimates, their standard errors and bands, and the torque of each
    pathway (NetCDF; `xarray.open_datatree` reads it);

    - `stiffness.png` and `.pdf`: stiffness, viscosity and inertia over time, with their bands;

    - where something is estimated over a variable, `scheduled.csv` (method, variable, value, quantity, unit, estimate
    and 95 % band), and `scheduled.png` and `.pdf` with a histogram of the variable;

    - with `--tune`, `tuning.csv`, `.png` and `.pdf`: the settings that were tried, and how well each did.

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --period 2 --torque-sign -1`

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --period 2
    --channel emg=EMG_SOL --method mymethod:Scheduled`

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --period 2
    --channel command=CMD --method kbr:reference=command,weighting=residual` (an actuator that gives way)

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --scheduling ankle_angle`
    """
    import numpy as np

    from tvsysid import preprocess
    from tvsysid.comparison import compare
    from tvsysid.figures import identified_impedance, save
    from tvsysid.methods import deviating_channels, parse
    from tvsysid.recordings import whole_file, write_models

    if period is None and scheduling is None:
        raise InputError(
            "--period is missing: the duration of one repetition of the behaviour; without repetitions, give the "
            "channel with a variable that the joint follows (--scheduling)"
        )
    if scheduling is not None:
        channel = [*channel, f"scheduling={scheduling}"]
        method = SCHEDULED_METHODS if method == DEFAULT_METHODS else method
    chosen = [parse(label) for label in method]
    check_folder(out)
    with shown_warnings():
        recording = options.read(file, angle, torque, rate, columns, torque_sign, angle_unit, start, channel)
        if align_channels:
            recording = _aligned(recording, period or PIECES, context)
        if decimate is not None:
            recording = preprocess.decimate(recording, decimate, sharp=period is None)
        if recording.sampling_rate > SLOW_RATE:
            text = "may take minutes; --decimate 100 is usual, and enough for a joint"
            remark("note", f"identifying at {recording.sampling_rate:g} Hz {text}")
        deviating = [name for name in deviating_channels(chosen) if name in recording.channels]
        ensemble = preprocess.segment(recording, period, context)
        if len(ensemble) > 1 or period is not None:
            ensemble = preprocess.subtract_mean(ensemble, deviating)
        say(f"{file.name}: {ensemble!r}")
        with progress("identifying") as advance:
            found = compare(ensemble, method, tune=tune, progress=advance, time_limit=time_limit)
    for label, reason in found.skipped.items():
        remark("warning", f"{label} is skipped: {reason}")
    for label, reason in found.failed.items():
        remark("error", f"{label} failed: {reason}")
    with whole_file(out / "stiffness.csv") as table:
        found.over_time().to_csv(table, index=False, float_format="%.6g")
    write_models(out / "models.nc", {label.replace("/", "_"): each for label, each in found.models.items()}, ensemble)
    title = _title(file, found)
    unknown = np.full(ensemble.samples, np.nan)  # over realizations, of which there must be several
    vaf = found.time_varying_vaf if len(ensemble) > 1 else dict.fromkeys(found.models, unknown)
    figure = identified_impedance(found.models, vaf, title)
    for ending in ("png", "pdf"):
        save(figure, out / f"stiffness.{ending}")
    scheduled = _write_scheduled(found, out, title)
    _show_impedance(found)
    _show_further(found)
    _show_reflex(found)
    say_written(
        out, ["stiffness.csv", "models.nc", "stiffness.png", "stiffness.pdf", *scheduled, *_write_tuning(found, out)]
    )
    if found.failed:
        raise typer.Exit(1)


def _aligned(recording: Recording, period: float, context: float) -> Recording:
    """Recording less a delay between the channels, if one is found; prints what was done."""
    from tvsysid.preprocess import align_channels
    from tvsysid.quality import find_delay

    delay = find_delay(recording, period, context)
    if not delay.found:
        say(f"--align-channels: nothing is corrected; the delay is {delay.state}: {delay.what}")
        return recording
    say(f"--align-channels: {_taken(delay.value / 1000)}; {delay.what}")
    return align_channels(recording, delay.value / 1000)


def _taken(seconds: float) -> str:
    """What is done about a delay of the torque, in words."""
    return f"the torque is taken {abs(1000 * seconds):.3g} ms {'earlier' if seconds > 0 else 'later'}"


def _show_answer(found: Comparison) -> None:
    """Print what the stiffness does by the method that decides this from the data."""
    import numpy as np

    from tvsysid.methods.adaptive.model import AdaptiveModel
    from tvsysid.methods.adaptive.words import changes

    for label, model in found.models.items():
        if not isinstance(model, AdaptiveModel):
            continue
        lower, upper = found.bands[label]["stiffness"]
        known, band = model.stiffness[np.isfinite(model.stiffness)], float(np.nanmean(upper - lower)) / 2
        say(
            f"stiffness by {label}, the one to go by: {known.min():.1f} to {known.max():.1f} N·m/rad, "
            f"{known.mean():.1f} on average, 95 % band ± {band:.1f}"
        )
        for sentence in changes(model):
            say(f"  {sentence}")


def _title(file: Path, found: Comparison) -> str:
    """What the figure shows: of which data, whether with bands, and what was done about a delay."""
    from tvsysid.figures.words import count

    ensemble = found.ensemble
    title = f"{file.name}: {count(len(ensemble), 'realization')} of {ensemble.duration:g} s"
    title += ", with 95 % bands" if found.has_bands else ""
    return f"{title}; {_taken(ensemble.delay_removed)}" if ensemble.delay_removed else title


def _show_impedance(found: Comparison) -> None:
    from tvsysid.figures.words import count

    _show_answer(found)
    headings = ["method", "mean\n(N·m/rad)", "95 % band\npointwise\n(N·m/rad)", "lowest, at\n(N·m/rad, s)"]
    headings += ["highest, at\n(N·m/rad, s)", "inertia\n(kg·m²)", "VAF\n(%)"]
    rows = [
        (
            row["method"],
            _number(row["stiffness (N·m/rad)"]),
            _number(row["half_band (N·m/rad)"], "± {:.1f}"),
            *(
                f"{_number(row[f'{end} (N·m/rad)'])}, {_number(row[f'{end} at (s)'], '{:.2f}')}"
                for end in ("lowest", "highest")
            ),
            _number(row["inertia (kg·m²)"], "{:.4f}"),
            _number(row["VAF (%)"]),
        )
        for row in found.summary().to_dict("records")
    ]
    cut = f"{count(len(found.ensemble), 'realization')} of {found.ensemble.duration:g} s"
    title = f"stiffness, inertia and VAF: {cut}"
    show_table(title, headings, rows)


def _show_further(found: Comparison) -> None:
    """Print what the methods estimate beside stiffness, viscosity and inertia over time, and the reflex's shape."""
    import numpy as np

    from tvsysid.figures.words import unit_name

    rows = []
    for label, model in found.models.items():
        for name, estimate in model.estimates.items():
            if name in ("stiffness", "viscosity", "inertia") and set(estimate.axes) <= {"realization", "time"}:
                continue
            known = estimate.values[np.isfinite(estimate.values)]
            numbers = [f"{each:.4g}" for each in ((known.mean(), known.min(), known.max()) if known.size else ())]
            error = estimate.standard_error
            if error is not None and numbers and np.isfinite(error.values).any():
                lower, upper = estimate.band()
                numbers.insert(1, f"± {np.nanmean(upper - lower) / 2:.3g}")
            else:
                numbers.insert(1, "-")
            rows.append((label, name.replace("_", " "), unit_name(estimate.unit), ", ".join(estimate.axes), *numbers))
    if rows:
        headings = ["method", "quantity", "unit", "over", "mean", "95 % band", "lowest", "highest"]
        show_table("further estimates", headings, rows, "llll")
    for label, model in found.models.items():
        if shape := _shape(model.diagnostics.details):
            say(f"{label}: {shape}")


def _shape(details: Mapping[str, float]) -> str:
    """Delay, muscle and threshold of a reflex, and how much of the torque each pathway explains."""
    found = []
    for name, unit in REFLEX.items():
        if name in details:
            error = details.get(f"{name}_error")
            spread = "" if error is None else f" ± {1.96 * error:.2g}"
            found.append(f"{name} {details[name]:.3g}{spread} {unit}".rstrip())
    shares = [f"{words} {details[name]:.1f} %" for name, words in EXPLAINED.items() if name in details]
    return "; ".join(part for part in (", ".join(found), ", ".join(shares)) if part)


def _show_reflex(found: Comparison) -> None:
    """Say whether the data show a reflex that some of the methods take for stiffness."""
    from tvsysid.quality import find_reflex

    one_path = [
        label
        for label, model in found.models.items()
        if "reflex" not in getattr(found.methods[label], "pathway_names", ()) and "reflex_gain" not in model.estimates
    ]
    reflex = find_reflex(found.ensemble)
    if one_path and reflex.found:
        remark(
            "warning", f"a reflex is taken for stiffness by {', '.join(one_path)}: {reflex.what}; {reflex.fault.remedy}"
        )


def _write_scheduled(found: Comparison, out: Path, title: str) -> list[str]:
    """Write what was estimated over variables, and draw it over the first of them; returns the names of the files."""
    from tvsysid.figures import save, scheduled_estimates
    from tvsysid.recordings import whole_file

    table = found.over_variables()
    if table.empty:
        return []
    with whole_file(out / "scheduled.csv") as file:
        table.to_csv(file, index=False, float_format="%.6g")
    variable = str(table.variable[0])
    if variable not in found.ensemble.channels:
        return ["scheduled.csv"]
    figure = scheduled_estimates(found.models, found.ensemble, variable, title)
    for ending in ("png", "pdf"):
        save(figure, out / f"scheduled.{ending}")
    return ["scheduled.csv", "scheduled.png", "scheduled.pdf"]


def _write_tuning(found: Comparison, out: Path) -> list[str]:
    """Print which settings were chosen, and write all that were tried; returns the names of the files."""
    import pandas as pd

    from tvsysid.figures import save, tuning_curves
    from tvsysid.methods import Method, typed
    from tvsysid.recordings import whole_file

    if not found.evidence:
        return []
    tuned = [each for label, each in found.methods.items() if label in found.evidence and isinstance(each, Method)]
    for label, item in found.evidence.items():
        say(f"{label}: {item}")
    say(f"the same settings again: {' '.join(f'--method {shlex.quote(typed(each))}' for each in tuned)}")
    tables = [item.to_pandas().assign(method=label) for label, item in found.evidence.items()]
    table = pd.concat(tables, ignore_index=True)
    with whole_file(out / "tuning.csv") as file:
        table[["method", *table.columns.drop("method")]].to_csv(file, index=False, float_format="%.6g")
    figure = tuning_curves(found.evidence)
    for ending in ("png", "pdf"):
        save(figure, out / f"tuning.{ending}")
    return ["tuning.csv", "tuning.png", "tuning.pdf"]


def _number(value: float, text: str = "{:.1f}") -> str:
    return text.format(value) if math.isfinite(value) else "-"
