"""`tvsysid identify`."""

from __future__ import annotations

import math
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import attrs
import typer

from tvsysid.cli import options
from tvsysid.cli.console import progress, remark, say, say_written, show_table, shown_warnings
from tvsysid.cli.identified import write_account, write_results, write_tuning
from tvsysid.cli.references import unnamed_references
from tvsysid.cli.running import check_folder
from tvsysid.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from tvsysid.comparison import Comparison
    from tvsysid.preprocess import Gap
    from tvsysid.quality import Finding
    from tvsysid.report import Account
    from tvsysid.signals import Ensemble, Recording

DEFAULT_METHODS = [
    "adaptive",
    "eirf",
    "sds",
    "birf",
    "esm",
    "kbr",
]  # of tvsysid.methods, which takes long to import
SCHEDULED_METHODS = ["lpv", "lpvkbi"]  # with a scheduling variable
SHOWN = 7  # values of a variable at which estimates are printed
# seconds of the pieces that are diagnosed, and searched for a delay, where there is no period
PIECES = 2.0
USUAL_RATE = 100.0  # Hz
SLOW_RATE = 250.0  # Hz from which on identifying without decimation takes minutes


def identify(
    file: options.FileArgument,
    angle: Annotated[str, options.ANGLE],
    torque: Annotated[str, options.TORQUE],
    rate: Annotated[float, options.RATE],
    period: Annotated[float | None, options.PERIOD] = None,
    scheduling: Annotated[
        str | None,
        options.option(
            "CHANNEL",
            "Channel with a variable that the joint follows; the methods are then lpv and lpvkbi "
            "unless given. Without "
            "--period, all of the record is one realization.",
        ),
    ] = None,
    decimate: options.DecimateOption = None,
    channel: options.ChannelOption = [],
    columns: options.ColumnsOption = "contiguous",
    torque_sign: options.TorqueSignOption = 1,
    angle_unit: options.AngleUnitOption = "rad",
    torque_unit: options.TorqueUnitOption = "Nm",
    header: options.HeaderOption = True,
    start: options.StartOption = 0.0,
    context: options.ContextOption = 0.5,
    method: options.MethodOption = DEFAULT_METHODS,
    align_channels: Annotated[
        bool,
        options.option("", "Correct a delay of the torque, unless that lowers the held-out VAF."),
    ] = True,
    remove_mains: Annotated[
        bool, options.option("", "Subtract mains hum (50 or 60 Hz) that shows in the angle.")
    ] = True,
    tune: Annotated[
        bool, options.option("", "Choose each method's settings from the data.", "--tune")
    ] = False,
    sheet: Annotated[
        bool,
        options.option(
            "",
            "Also write `sheet.html`, one page of A4 to print, for research use only.",
            "--sheet",
        ),
    ] = False,
    out: options.OutOption = Path("tvsysid-identify"),
) -> None:
    """Identify stiffness over time from a recording.

    Reads angle and torque (`tvsysid inspect FILE` shows the names in a file), decimates them, cuts
    the recording into realizations of one period, subtracts the mean over realizations, and
    identifies by each method: by default `adaptive`, which has no settings and is recommended, and
    five for comparison. Where the data make every stiffness wrong, none is stated, and the first
    lines say why and what to do.

    A 95 % band accounts for noise only: it does not include the error of a method that smooths too
    much. That of `adaptive` counts how unsure it is of how fast stiffness changes, and when it
    switches.

    VAF is the share of the recorded torque's variance that the model predicts. It is computed from
    the data that the model was identified from, so a method with many parameters has a high VAF
    even where its stiffness is mostly noise. Compare methods by the VAF of realizations that were
    held out: each fifth of them (consecutive ones) is predicted by what the method identifies from
    the others.

    A method that needs a further channel (EMG, a reference signal, a scheduling variable) gets it
    by `--channel`. An input or a reference loses its mean as angle and torque do; a scheduling
    variable keeps it. A method that cannot serve the recording is skipped, and the reason is
    printed. One that fails spoils no other; the exit code is then 1.

    A joint that follows a measured variable needs no period: with `--scheduling` and without
    `--period`, all of the record is one realization, and `--decimate` takes a sharper filter, as
    torque beyond the new band counts more there. The variable is read under the name `scheduling`.

    Where the torque is late or early, as by `tvsysid inspect --diagnose`, that is corrected before
    decimation, unless correcting half or none of it predicts realizations held out better; a line
    says so. The figure's title states what was corrected, and `delay_removed` (in s) in
    `models.nc`. `--no-align-channels` corrects nothing.

    Realizations with a gap, where both signals were held, zero or interpolated for 30 ms or more,
    are left out. Mains hum that shows in the angle is subtracted from all channels before
    decimation. A line says so.

    Writes to the folder:

    - `report.html`: all of it on one page: the stiffness to report with its band, how it was found,
      what is wrong with
    the data and what to do, the methods side by side and why they differ, and a methods paragraph
    with references (BibTeX) for a paper;

    - with `--sheet`, `sheet.html`: one page of A4 about one person and visit; `tvsysid report DIR
      DIR … --sheet` makes
    one of several visits;

    - `stiffness.csv`: time_s, method, stiffness (N·m/rad), viscosity (N·m·s/rad) and inertia
      (kg·m²), each with its
    95 % band (`stiffness_lower`, `stiffness_upper`, …), and time_varying_vaf (%); a further
    quantity that a method estimates over time has columns of the same kind;

    - `models.nc`: a group for each method with its estimates, their standard errors and bands, and
      the torque of each
    pathway (NetCDF; `xarray.open_datatree` reads it);

    - `stiffness.png` and `.pdf`: stiffness, viscosity and inertia over time, with their bands;

    - where something is estimated over a variable, `scheduled.csv` (method, variable, value,
      quantity, unit, estimate
    and 95 % band), and `scheduled.png` and `.pdf` with a histogram of the variable;

    - with `--tune`, `tuning.csv`, `.png` and `.pdf`: the settings that were tried, and how well
      each did.

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --period
    2 --torque-sign -1`

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --period
    2 --channel emg=EMG_SOL --method mymethod:Scheduled`

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100 --period
    2 --channel command=CMD --method kbr:reference=command,weighting=residual` (an actuator that
    gives way)

    Example: `tvsysid identify ankle.mat --angle pos --torque tq --rate 1000 --decimate 100
    --scheduling ankle_angle`
    """
    from tvsysid import preprocess
    from tvsysid.comparison import compare
    from tvsysid.methods import deviating_channels, parse

    if period is None and scheduling is None:
        raise InputError(
            "--period is missing: the duration of one repetition of the behaviour (s); for a "
            "joint that is held still, "
            "any will do (--period 2); where nothing repeats, give the channel with a variable "
            "that the joint follows "
            "(--scheduling)"
        )
    if scheduling is not None:
        channel = [*channel, f"scheduling={scheduling}"]
        method = SCHEDULED_METHODS if method == DEFAULT_METHODS else method
    chosen = [parse(label) for label in method]
    check_folder(out)
    as_read = (rate, columns, torque_sign, angle_unit, start, header, torque_unit)
    read = partial(options.read, file, angle, torque, *as_read)
    with shown_warnings():
        recorded, gaps, faults, done = _cleaned(read(channel), remove_mains, period, context)
        deviating = [name for name in deviating_channels(chosen) if name in recorded.channels]

        @cache
        def prepared(delay: float) -> tuple[Recording, Ensemble]:
            recording = preprocess.align_channels(recorded, delay) if delay else recorded
            if decimate is not None:
                recording = preprocess.decimate(recording, decimate, sharp=period is None)
            ensemble = preprocess.segment(recording, period, context, gaps)
            several = len(ensemble) > 1 or period is not None
            return recording, preprocess.subtract_mean(ensemble, deviating) if several else ensemble

        if decimate is None:
            _remark_on(recorded.sampling_rate)
        delay = _delay(prepared, context, deviating, method[0]) if align_channels else 0.0
        recording, ensemble = prepared(delay)
        say(f"{file.name}: {ensemble!r}")
        with progress("identifying") as advance:
            found = compare(ensemble, method, tune=tune, progress=advance)
    for label, reason in found.skipped.items():
        remark("warning", f"{label} is skipped: {reason}")
    for label, reason in found.failed.items():
        remark("error", f"{label} failed: {reason}")
    turned = f"in {torque_unit.replace('N', 'N·')}" + (
        ", with its sign reversed" if torque_sign == -1 else ""
    )
    source = {
        "file": file.name,
        "angle": f"channel {angle}, in {angle_unit}",
        "torque": f"channel {torque}, {turned}",
    }
    known = [angle, torque, *(text.partition("=")[2] for text in channel)]
    as_typed = {
        "the torque's sign was reversed": torque_sign == -1,
        "degrees became radians": angle_unit == "deg",
    }
    as_typed["N·mm became N·m"] = torque_unit == "Nmm"
    write_results(found, out)  # what is found is kept if holding out is interrupted
    account = _account(found, source, _judged(ensemble, recording, context, deviating), faults)
    unnamed = tuple(unnamed_references(found, file, header, known, read))
    account = attrs.evolve(
        account,
        turned=[*done, *(words for words, was in as_typed.items() if was)],
        unnamed_references=unnamed,
    )
    written = write_account(account, out, file.name, sheet)
    _show_impedance(account)
    _show_further(found)
    _show_reflex(account)
    _show_diagnosis(account)
    _show_recommendation(account)
    say_written(out, [*written, *write_tuning(found, out)])
    if found.failed:
        raise typer.Exit(1)


def decimation(rate: float) -> str:
    """Option that makes a recording at a rate in Hz quick to identify; empty where it is."""
    from tvsysid.preprocess.decimate import fitting_rates

    return f"--decimate {fitting_rates(rate, USUAL_RATE)[0]:g}" if rate > SLOW_RATE else ""


def _remark_on(rate: float) -> None:
    """Say that identifying at a high rate takes long."""
    if rate > SLOW_RATE:
        slow = f"identifying at {rate:g} Hz takes minutes, where seconds do"
        remark(
            "note",
            f"{slow}; {decimation(rate)} is usual, and enough for a joint (Ctrl-C, and give it)",
        )


def _cleaned(
    recording: Recording, remove_mains: bool, period: float | None, context: float
) -> tuple[Recording, tuple[Gap, ...], list[Finding], list[str]]:
    """Recording less mains hum; gaps to leave out; faults that stay.

    What was done, which is printed.
    """
    from tvsysid import preprocess
    from tvsysid.figures.words import count
    from tvsysid.quality import diagnose_recording

    found, done = diagnose_recording(recording), []
    gaps = preprocess.find_gaps(recording) if period else ()
    if gaps:
        every, kept = (
            len(preprocess.segment(recording, period, context, each)) for each in ((), gaps)
        )
        lost = (
            f"{count(every - kept, 'realization')} with gaps "
            f"{'was' if every - kept == 1 else 'were'} left out"
        )
        done += [lost] * (every > kept)
        say(f"{found.pop('gaps').what}; {lost}")
    if remove_mains and found["mains"].found:
        done.append("mains hum was subtracted from all channels")
        say(f"{found.pop('mains').what}; {done[-1]}")
        recording = preprocess.remove_mains(recording, preprocess.find_mains(recording)[0])
    return recording, gaps, list(found.values()), done


def _delay(
    prepared: Callable[[float], tuple[Recording, Ensemble]],
    context: float,
    deviating: Iterable[str],
    method: str,
) -> float:
    """How much of a delay between the channels to correct, in s; says so if there is one."""
    from tvsysid.comparison import delay_to_correct

    recording, ensemble = prepared(0.0)
    judged = _judged(ensemble, recording, context, deviating)
    delay, text = delay_to_correct(lambda each: prepared(each)[1], judged, method)
    if text:
        say(text)
    return delay


def _show_impedance(account: Account) -> None:
    """Print the answer, and a row for each method."""
    from tvsysid.figures.words import count
    from tvsysid.report.answer import answer

    found = account.found
    withdrawn = account.trust.level == "none"
    if len(lines := answer(account)) > 1 or withdrawn:  # more than the table says
        say("\n  ".join(lines))
    headings = [
        "method",
        "mean",
        "95 %\nband",
        "lowest, at",
        "highest, at",
        "inertia",
        "VAF",
        "VAF\nheld\nout",
    ]
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
            _number(account.held_out_mean(row["method"])),
        )
        for row in found.rows()
    ]
    cut = f"{count(len(found.ensemble), 'realization')} of {found.ensemble.duration:g} s"
    title = (
        "stiffness (N·m/rad) with its pointwise band and extremes (at, s), inertia (kg·m²) "
        f"and VAF (%): {cut}"
    )
    show_table(f"{'not valid: ' if withdrawn else ''}{title}", headings, rows)


def _show_further(found: Comparison) -> None:
    """Print what the methods estimate beside stiffness, viscosity and inertia over time, and the reflex's shape."""
    import numpy as np

    from tvsysid.report.answer import further, reflex_shape

    _show_over_variables(found)
    rows = []
    for each in further(found):
        if each.quantity.startswith("scheduled "):  # is shown at values of the variable
            continue
        numbers = [
            f"{end(each.values):.4g}" if each.values.size else "-"
            for end in (np.mean, np.min, np.max)
        ]
        numbers.insert(1, _number(each.half_band, "± {:.3g}"))
        rows.append((each.method, each.quantity, each.unit, each.over, *numbers))
    if rows:
        headings = ["method", "quantity", "unit", "over", "mean", "95 % band", "lowest", "highest"]
        show_table("further estimates", headings, rows, "llll")
    for label, model in found.models.items():
        if shape := reflex_shape(model.diagnostics.details):
            say(f"{label}: {shape}")


def _show_over_variables(found: Comparison) -> None:
    """Print what was estimated over a variable, at some of its values."""
    import numpy as np

    from tvsysid.figures.words import unit_name

    if not found.rows_over_variables():
        return
    table = found.over_variables()
    for (label, variable), own in table.groupby(["method", "variable"], sort=False):
        units = own.drop_duplicates("quantity").set_index("quantity").unit
        headings = [
            f"{name.removeprefix('scheduled_').replace('_', ' ')}\n({unit_name(units[name])})"
            for name in units.index
        ]
        values = own.value.unique()
        rows = [
            (
                f"{value:.3g}",
                *(
                    _with_band(*own[(own.value == value) & (own.quantity == name)].iloc[0, -3:])
                    for name in units.index
                ),
            )
            for value in values[
                np.linspace(0, len(values) - 1, min(len(values), SHOWN)).round().astype(int)
            ]
        ]
        show_table(f"{label} over {variable}, ± 95 % band", [str(variable), *headings], rows, "r")


def _with_band(value: float, lower: float, upper: float) -> str:
    return f"{value:.3g}" + _number((upper - lower) / 2, " ± {:.2g}").removesuffix("-")


def _judged(
    ensemble: Ensemble, recording: Recording, context: float, deviating: Iterable[str]
) -> Ensemble:
    """What to diagnose: the ensemble, or pieces of a record that does not repeat."""
    from tvsysid.preprocess import segment, subtract_mean

    with suppress(InputError):  # it is too short for two of them
        if not ensemble.mean_subtracted:
            return subtract_mean(segment(recording, PIECES, context), deviating)
    return ensemble


def _account(
    found: Comparison, source: dict[str, str], judged: Ensemble, faults: list[Finding]
) -> Account:
    """What was found, with held-out VAF and a diagnosis, which gets the faults of the recording."""
    from tvsysid.quality import diagnose
    from tvsysid.report import Account

    with shown_warnings(), progress("predicting realizations held out") as advance:
        held_out = found.held_out_vaf(progress=advance)
    try:
        repeats = judged is found.ensemble
        diagnosis = (found.recommendation.diagnosis if repeats else None) or diagnose(
            judged, repeats=repeats
        )
        diagnosis = attrs.evolve(diagnosis, checks=(*diagnosis.checks, *faults))
        return Account(found, held_out, diagnosis, source=source)
    except InputError as error:
        return Account(
            found, held_out, undiagnosed=str(error).removeprefix("diagnose: "), source=source
        )


def _show_diagnosis(account: Account) -> None:
    """Say what a diagnosis of the ensemble found, in a line, and what could be better."""
    if account.diagnosis is not None:
        for text in account.diagnosis.remarks:
            remark("note", text)
        names = ", ".join(each.name for each in account.diagnosis.findings)
        say(
            "diagnosis: "
            f"{account.diagnosis.verdict}{f': {names} (report.html says what to do)' if names else ''}"
        )
    else:
        say(f"diagnosis: none: {account.undiagnosed}")


def _show_recommendation(account: Account) -> None:
    """Say which method suits the data, unless it is the leading one, or no stiffness is stated."""
    best = account.found.recommendation
    if account.found.leading not in best.suited[:1] and account.trust.level != "none":
        say(f"method for these data: {best.sentence}")


def _show_reflex(account: Account) -> None:
    """Say whether the data show a reflex that some of the methods take for stiffness."""
    from tvsysid.quality import find_reflex
    from tvsysid.report.answer import one_pathway, reflex_found

    found, one_path = account.found, one_pathway(account.found)
    told = found.leading in one_path and bool(reflex_found(account))
    if not one_path or told or account.trust.level == "none":
        return
    names, reflex = ", ".join(one_path), find_reflex(found.ensemble)
    if reflex.found:
        remark(
            "warning",
            f"a reflex is taken for stiffness by {names}: {reflex.what}; {reflex.fault.remedy}",
        )
    elif "reflex_gain" in found.models[found.leading].estimates:
        remark(
            "note",
            f"{found.leading} estimates a reflex beside the stiffness, which {names} take for "
            "stiffness",
        )


def _number(value: float, text: str = "{:.1f}") -> str:
    return text.format(value) if math.isfinite(value) else "-"
