"""`tvsysid identify`."""

from __future__ import annotations

import shlex
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tvsysid.cli.console import progress, remark, say, say_written, show_table, shown_warnings
from tvsysid.cli.options import (
    ANGLE,
    PERIOD,
    RATE,
    TORQUE,
    AngleUnit,
    AngleUnitOption,
    Columns,
    ColumnsOption,
    ContextOption,
    DecimateOption,
    MethodOption,
    OutOption,
    StartOption,
    TorqueSignOption,
)
from tvsysid.cli.recording import read
from tvsysid.cli.running import check_folder
from tvsysid.errors import DataQualityWarning, InputError

if TYPE_CHECKING:
    import pandas as pd

    from tvsysid.methods import Method
    from tvsysid.models import Model
    from tvsysid.signals import Ensemble

DEFAULT_METHODS = ["eirf", "sds", "birf", "esm", "kbr"]  # those of tvsysid.methods.names(), which takes long to import
SLOW_RATE = 250.0
"""Hz from which on identifying without decimation takes minutes."""


def identify(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="MAT, CSV, TSV, NPZ, HDF5, NetCDF, Parquet or C3D file.")
    ],
    angle: Annotated[str, ANGLE],
    torque: Annotated[str, TORQUE],
    rate: Annotated[float, RATE],
    period: Annotated[float, PERIOD],
    decimate: DecimateOption = None,
    columns: ColumnsOption = Columns.contiguous,
    torque_sign: TorqueSignOption = 1,
    angle_unit: AngleUnitOption = AngleUnit.rad,
    start: StartOption = 0.0,
    context: ContextOption = 0.5,
    method: MethodOption = DEFAULT_METHODS,
    tune: Annotated[bool, typer.Option("--tune", help="Choose each method's settings from the data.")] = False,
    out: OutOption = Path("tvsysid-identify"),
) -> None:
    """Identify stiffness over time from a recording.

    Reads angle and torque (`tvsysid inspect FILE` shows the names in a file), decimates, cuts the record into
    realizations of one period, subtracts the mean over realizations, and identifies by each method.

    A band holds the truth 95 times in 100 as far as noise goes; what a method smooths away is not in it.

    VAF is the share of the recorded torque that the model predicts for the very data it was identified from: a method
    with many parameters has a high one even where its stiffness is noise.

    Writes to the folder:

    - `stiffness.csv`: time_s, method, stiffness (N·m/rad), viscosity (N·m·s/rad) and inertia (kg·m²), each with its
    95 % band (`stiffness_lower`, `stiffness_upper`, …), and time_varying_vaf (%);

    - `models.nc`: all that was identified, a group for each method (NetCDF; `xarray.open_datatree` reads it);

    - `stiffness.png` and `.pdf`: the same over time, bands as shades;

    - with `--tune`, `tuning.csv`, `.png` and `.pdf`: the settings that were tried, and how each did.

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --period 2 --torque-sign -1`
    """
    from threadpoolctl import threadpool_limits

    from tvsysid import preprocess
    from tvsysid.figures import identified_impedance, save
    from tvsysid.methods import Tuned, parse
    from tvsysid.metrics import time_varying_vaf, vaf
    from tvsysid.recordings import whole_file, write_models

    chosen = {label: parse(label) for label in dict.fromkeys(method)}
    check_folder(out)
    with shown_warnings():
        recording = read(file, angle, torque, rate, columns, torque_sign, angle_unit, start)
        if decimate is not None:
            recording = preprocess.decimate(recording, decimate)
        if recording.sampling_rate > SLOW_RATE:
            remark(
                "note",
                f"identifying at {recording.sampling_rate:g} Hz may take minutes; "
                "--decimate 100 is usual, and enough for a joint",
            )
        ensemble = preprocess.subtract_mean(preprocess.segment(recording, period, context))
        say(f"{file.name}: {ensemble!r}")
        models: dict[str, Model] = {}
        bands: dict[str, dict[str, Any]] = {}
        tuned: dict[str, Method] = {}
        # Small matrices: BLAS threads would only wait for each other.
        with progress("identifying") as advance, threadpool_limits(1):
            for number, (label, item) in enumerate(chosen.items()):
                advance(number, len(chosen))
                if tune or isinstance(item, Tuned):
                    tuned[label] = _tuned(label, item, ensemble)
                models[label] = _identified(label, tuned.get(label, item), ensemble)
                bands[label] = _bands_of(label, models[label])
    measured = ensemble.torque[:, ensemble.core]
    predictions = {label: model.predict(ensemble) for label, model in models.items()}
    over_time = {label: time_varying_vaf(measured, predicted) for label, predicted in predictions.items()}
    shares = {label: vaf(measured, predicted) for label, predicted in predictions.items()}
    with whole_file(out / "stiffness.csv") as table:
        _stiffness_table(models, bands, over_time).to_csv(table, index=False, float_format="%.6g")
    write_models(out / "models.nc", {label.replace("/", "_"): model for label, model in models.items()})
    title = f"{file.name}: {len(ensemble)} realizations of {period:g} s, with 95 % bands"
    figure = identified_impedance(models, bands, over_time, title)
    for ending in ("png", "pdf"):
        save(figure, out / f"stiffness.{ending}")
    _show_models(models, bands, shares, ensemble)
    written = ["stiffness.csv", "models.nc", "stiffness.png", "stiffness.pdf"]
    if tuned:
        written += _write_tuning(tuned, out)
    say_written(out, written)


def _identified(label: str, method: Any, ensemble: Ensemble) -> Model:
    """Model, whoever's the method is; an error of somebody else's is told with its place."""
    from tvsysid.errors import describe_error
    from tvsysid.methods import apply

    try:
        return apply(method, ensemble, label)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"method {label}: {describe_error(error)}") from error


def _tuned(label: str, method: Any, ensemble: Ensemble) -> Method:
    """Method with settings chosen from the data."""
    from tvsysid.methods import Method, Tuned

    if isinstance(method, Tuned):
        method = method.method
    if not isinstance(method, Method):
        raise InputError(
            f"--tune: settings of {label} cannot be chosen from data; leave out --tune, and write key:tuned=true for "
            "those methods whose settings can"
        )
    return method.tuned(ensemble)


def _write_tuning(tuned: dict[str, Method], out: Path) -> list[str]:
    """Print what was chosen, and write all that was tried; names of the files."""
    import pandas as pd

    from tvsysid.figures import save, tuning_curves
    from tvsysid.methods import typed
    from tvsysid.recordings import whole_file

    evidence = {label: method.evidence for label, method in tuned.items() if method.evidence is not None}
    for label, item in evidence.items():
        say(f"{label}: {item}")
    again = " ".join(f"--method {shlex.quote(typed(method))}" for method in tuned.values())
    say(f"the same again: {again}")
    tables = []
    for label, item in evidence.items():
        table = item.to_pandas()
        table.insert(0, "method", label)
        tables.append(table)
    with whole_file(out / "tuning.csv") as file:
        pd.concat(tables, ignore_index=True).to_csv(file, index=False, float_format="%.6g")
    figure = tuning_curves(evidence)
    for ending in ("png", "pdf"):
        save(figure, out / f"tuning.{ending}")
    return ["tuning.csv", "tuning.png", "tuning.pdf"]


def _bands_of(label: str, model: Model) -> dict[str, Any]:
    """Lower and upper 95 % band of each quantity; warns where a method that states standard errors has none."""
    import numpy as np

    error = model.estimates["stiffness"].standard_error
    if error is not None and error.absent:
        warnings.warn(f"{label}: no band: {error.absent}", DataQualityWarning, stacklevel=2)
    absent = (np.full(len(model.time), np.nan),) * 2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        found = {name: each.band() for name, each in model.estimates.items() if each.axes == ("time",)}
    return dict.fromkeys(("stiffness", "viscosity", "inertia"), absent) | found


def _show_models(
    models: dict[str, Model], bands: dict[str, dict[str, Any]], shares: dict[str, Any], ensemble: Ensemble
) -> None:
    import numpy as np

    title = f"stiffness, inertia and VAF: {len(ensemble)} realizations of {ensemble.duration:g} s"
    headings = [
        "method",
        "mean\n(N·m/rad)",
        "95 % band\n(N·m/rad)",
        "lowest, at\n(N·m/rad,s)",
        "highest, at\n(N·m/rad,s)",
        "inertia\n(kg·m²)",
        "VAF\n(%)",
    ]
    rows = []
    for label, model in models.items():
        stiffness, time = model.stiffness, model.time
        extremes = []
        for place in (np.nanargmin(stiffness), np.nanargmax(stiffness)):
            extremes.append(f"{stiffness[place]:.1f}, {time[place]:.2f}")
        lower, upper = bands[label]["stiffness"]
        width = (upper - lower) / 2
        known = model.inertia[np.isfinite(model.inertia)]
        row = (
            label,
            f"{np.nanmean(stiffness):.1f}",
            f"± {np.nanmean(width):.1f}" if np.isfinite(width).any() else "-",
            *extremes,
            f"{known.mean():.4f}" if len(known) else "-",
            f"{np.nanmean(shares[label]):.1f}",
        )
        rows.append(row)
    show_table(title, headings, rows)


def _stiffness_table(
    models: dict[str, Model], bands: dict[str, dict[str, Any]], over_time: dict[str, Any]
) -> pd.DataFrame:
    import pandas as pd

    tables = []
    for label, model in models.items():
        columns = {"time_s": model.time, "method": label}
        for name, (lower, upper) in bands[label].items():
            columns |= {name: model.over_time(name), f"{name}_lower": lower, f"{name}_upper": upper}
        tables.append(pd.DataFrame(columns | {"time_varying_vaf": over_time[label]}))
    return pd.concat(tables, ignore_index=True)
