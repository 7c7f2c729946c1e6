"""Page of one identification: the stiffness to report, its reasons and its trustworthiness."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.errors import by_text
from tvsysid.figures import (
    Illustration,
    draw_all,
    identified_impedance,
    scheduled_estimates,
    variable_of,
)
from tvsysid.figures.identification import drawn_quantities
from tvsysid.figures.words import count, unit_name
from tvsysid.methods.adaptive.model import AdaptiveModel
from tvsysid.numerics.bands import mean_of
from tvsysid.recommendation.trust import sentence
from tvsysid.report.answer import (
    IMPEDANCE_UNITS,
    Account,
    answer,
    further,
    others,
    reflex_shape,
    switches,
    taken,
    why_leading,
    with_reflex,
)
from tvsysid.report.diagnosis import findings_table
from tvsysid.report.page import in_text, render
from tvsysid.report.paragraph import methods_bibliography, methods_paragraph, settings_of

if TYPE_CHECKING:
    import pandas as pd


def write_identification(
    path: str | Path,
    account: Account,
    command: str = "",
    figures: Mapping[str, Illustration] | None = None,
) -> None:
    """Write one HTML file that says what was identified and how, and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    account
        What was found, and what is known of it.
    command
        What was typed, if it is to be mentioned.
    figures
        Figures by name, if they are drawn already; as ``illustrations`` returns them.

    Examples
    --------
    >>> import tempfile, tvsysid as tv
    >>> simulation = tv.simulate.Joint().simulate(
    ...     40, perturbation=tv.simulate.PRBS(), snr_db=10, seed=1)
    >>> recording = tv.preprocess.decimate(simulation.recording, 100)
    >>> ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))
    >>> found = tv.compare(ensemble, ["sds", "birf"])
    >>> account = tv.report.Account(found, found.held_out_vaf(), tv.diagnose(ensemble))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     tv.report.write_identification(f"{folder}/report.html", account)
    """
    found, label = account.found, account.found.leading
    name, blamed = account.source.get("file", "an ensemble"), with_reflex(account)
    held_out, in_sample = account.held_out_mean(label), mean_of(found.vaf[label])
    shapes = {each: reflex_shape(model.diagnostics.details) for each, model in found.models.items()}
    likely, unlikely = (_switches(account, is_likely) for is_likely in (True, False))
    render(
        path,
        "identification.html",
        account=account,
        found=found,
        ensemble=found.ensemble,
        diagnosis=account.diagnosis,
        trust=account.trust,
        name=name,
        label=label,
        adaptive=isinstance(found.models[label], AdaptiveModel),
        lines=list(map(sentence, answer(account))),
        why=why_leading(account),
        others=others(found),
        with_reflex="all" if len(blamed) == len(found.models) - 1 else ", ".join(blamed),
        held_out=held_out if math.isfinite(held_out) else None,
        in_sample=in_sample if math.isfinite(in_sample) else None,
        pictures=draw_all(figures or illustrations(account)),
        quantities=_quantities(account),
        switches=likely,
        unlikely=unlikely,
        data=_data(account),
        findings=findings_table(account.diagnosis),
        measured=_measured(account),
        methods=_methods(account),
        differences=_differences(account),
        further=_further(account),
        shapes=[f"{each}: {shape}." for each, shape in shapes.items() if shape],
        problems=_problems(account),
        paragraph=methods_paragraph(account),
        bibliography=methods_bibliography(account),
        command=command,
    )


def illustrations(account: Account) -> dict[str, Illustration]:
    """Return the answer, estimates over a variable, and a comparison if methods are several."""
    found, label = account.found, account.found.leading
    withdrawn = account.trust.level == "none"
    vaf, variable = found.time_varying_vaf, variable_of(found.models, found.ensemble)
    below = ", and the time-varying VAF" if vaf else ""

    def impedance(title: str, whose: str, labels: list[str]) -> Illustration:
        models = {each: found.models[each] for each in labels}
        *names, last = (each.replace("_", " ") for each in drawn_quantities(models, variable))
        text = whose.format(f"{', '.join(names)} and {last}")
        text = f"{text[:1].upper()}{text[1:]}, with 95 % bands{below}."
        draw = partial(identified_impedance, models, vaf, but_over=variable)
        return Illustration(draw, title, text)

    drawn = {}
    if not withdrawn:
        title = f"Impedance over time by {label}"
        drawn["answer"] = impedance(title, f"{{}} by {label}", [label])
        if variable:
            draw = partial(scheduled_estimates, found.models, found.ensemble, variable)
            text = (
                f"Quantities that follow {variable}, with 95 % bands, above how long {variable} "
                "was near each of its values."
            )
            drawn["variable"] = Illustration(draw, f"Estimates over {variable}", text)
    if withdrawn or len(found.models) > 1:
        title = "Impedance over time by all methods"
        drawn["methods"] = impedance(title, "each method’s {}", list(found.models))
    return drawn


def _frame(rows: list[dict[str, str]]) -> pd.DataFrame:
    import pandas as pd  # noqa: PLC0415  # heavy

    return pd.DataFrame(rows)


def _quantities(account: Account) -> pd.DataFrame:
    """Return every quantity over time by the leading method."""
    found, label = account.found, account.found.leading
    model, rows = found.models[label], []
    for name, (lower, upper) in found.bands[label].items():
        values = model.over_time(name)
        if not np.isfinite(values).any():
            continue
        row = {
            "quantity": name.replace("_", " "),
            "unit": IMPEDANCE_UNITS.get(name) or unit_name(model.estimates[name].unit),
            "mean": in_text(mean_of(values)),
            "95 % band, ±": in_text(mean_of(upper - lower) / 2),
        }
        for end, find in {"lowest": np.nanargmin, "highest": np.nanargmax}.items():
            at = int(find(values))
            row |= {end: in_text(values[at]), f"{end} at (s)": in_text(model.time[at], decimals=2)}
        rows.append(row)
    return _frame(rows)


def _switches(account: Account, is_likely: bool) -> pd.DataFrame:
    """Return the sudden changes that the leading method found, likely or unlikely."""
    model = account.found.models[account.found.leading]
    return _frame(
        [
            {
                "quantity": name,
                "at (s)": in_text(each.time, decimals=3),
                "between (s)": f"{each.earliest:.3f} to {each.latest:.3f}",
                "change": in_text(
                    each.size, 1.96 * each.size_error, 1 if name == "stiffness" else 3
                ),
                "probability (%)": in_text(100 * each.probability, decimals=0),
            }
            for name in IMPEDANCE_UNITS
            for each in switches(model, name)
            if (each.probability > 0.5) is is_likely
        ]
    )


def _data(account: Account) -> pd.DataFrame:
    """Return where the data come from, and what was done to them."""
    ensemble = account.found.ensemble
    rate, ratio = ensemble.sampling_rate, ensemble.angle_as_recorded.shape[-1]
    trials = len(np.unique(np.asarray(ensemble.trials)))
    lost, delay = ensemble.left_out, ensemble.delay_removed
    rows = {
        **account.source,
        "recorded at": f"{rate * ratio:g} Hz",
        "identified at": f"{rate:g} Hz{', low-pass filtered and decimated' if ratio > 1 else ''}",
        "realizations": f"{len(ensemble)} of {ensemble.duration:g} s, from "
        f"{count(trials, 'trial')}",
        "realizations left out": f"{lost}: no context" if lost else "none",
        "context": f"{ensemble.context / rate:g} s on either side",
        "mean over realizations": "subtracted" if ensemble.mean_subtracted else "not subtracted",
        "delay between the channels": taken(delay) if delay else "not corrected",
        "further channels": ", ".join(ensemble.channels) or "none",
    }
    if account.diagnosis is not None:
        rms, width, snr = (
            account.diagnosis.measures[name][0]
            for name in ("angle RMS", "bandwidth of the angle", "signal-to-noise ratio")
        )
        rows["perturbation"] = f"{rms:.3g} rad RMS, 95 % of its power below {width:.3g} Hz"
        rows["signal-to-noise ratio"] = f"{snr:.1f} dB, by the diagnosis"
    return _frame([{"what": what, "value": value} for what, value in rows.items()])


def _measured(account: Account) -> pd.DataFrame:
    """Return the properties of the data that the recommendation depends on."""
    return _frame(
        [
            {
                "property": name,
                "value": in_text(value, decimals=0 if value.is_integer() else None),
                "unit": "" if math.isnan(value) else unit,
            }
            for name, (value, unit) in account.found.recommendation.measured.items()
        ]
    )


def _methods(account: Account) -> pd.DataFrame:
    """Return stiffness, inertia and VAF by each method."""
    rows = []
    for row in account.found.summary().to_dict("records"):
        values = {
            "mean (N·m/rad)": (row["stiffness (N·m/rad)"], 1),
            "95 % band, ± (N·m/rad)": (row["half_band (N·m/rad)"], 1),
            "lowest (N·m/rad)": (row["lowest (N·m/rad)"], 1),
            "highest (N·m/rad)": (row["highest (N·m/rad)"], 1),
            "inertia (kg·m²)": (row["inertia (kg·m²)"], 4),
            "VAF in sample (%)": (row["VAF (%)"], 1),
            "VAF held out (%)": (account.held_out_mean(row["method"]), 1),
        }
        texts = {name: in_text(value, decimals=digits) for name, (value, digits) in values.items()}
        rows.append({"method": row["method"], **texts})
    return _frame(rows)


def _differences(account: Account) -> pd.DataFrame:
    """Return why each method's stiffness differs, with its settings."""
    return _frame(
        [
            {
                "method": label,
                "what it is": account.found.methods[label].title,
                "settings": settings_of(account.found.methods[label]) or "none",
                "its stiffness": account.found.methods[label].differs
                or "This is your own method: its assumptions are not known here.",
            }
            for label in account.found.models
        ]
    )


def _further(account: Account) -> pd.DataFrame:
    """Return the estimates beside stiffness, viscosity and inertia over time."""
    return _frame(
        [
            {
                **{name: getattr(each, name) for name in ("method", "quantity", "unit", "over")},
                "mean": in_text(each.mean),
                "95 % band, ±": in_text(each.half_band),
                "lowest": in_text(each.lowest),
                "highest": in_text(each.highest),
            }
            for each in further(account.found)
        ]
    )


def _problems(account: Account) -> pd.DataFrame:
    """Return failures, skipped methods and warnings."""
    found = account.found
    warned = (
        (label, text)
        for label, model in found.models.items()
        for text in model.diagnostics.warnings
    )
    rows = [
        *((label, "failed", why) for label, why in found.failed.items()),
        *((label, "skipped", why) for label, why in found.skipped.items()),
        *((", ".join(labels), "warning", text) for text, labels in by_text(warned).items()),
    ]
    return _frame([dict(zip(("method", "what", "why"), row, strict=True)) for row in rows])
