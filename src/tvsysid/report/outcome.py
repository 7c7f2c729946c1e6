"""First section of an identification's page: the stiffness, its reasons and its pictures."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from tvsysid.figures import (
    Illustration,
    identified_impedance,
    scheduled_estimates,
    variable_of,
)
from tvsysid.figures.identification import drawn_quantities
from tvsysid.figures.words import unit_name
from tvsysid.methods.adaptive.model import AdaptiveModel
from tvsysid.numerics.bands import mean_of
from tvsysid.recommendation.trust import sentence
from tvsysid.report import page
from tvsysid.report.answer import (
    IMPEDANCE_UNITS,
    Account,
    answer,
    others,
    switches,
    why_leading,
    with_reflex,
)

BAND = (
    "At each time, the true value should lie in the band with a probability of 95 %. The band "
    "counts noise, and nothing that the method smooths away."
)


ADAPTIVE_BAND = (
    "At each time, the true value should lie in the band with a probability of 95 %. The band "
    "counts noise, and how unsure the method is of how fast stiffness changes and of when it "
    "switches."
)


VAF = (
    "VAF is the share of the torque’s variance that a model predicts; a prediction worse than none "
    "counts as 0. In sample, it is that of the data that the model was identified from, and rises "
    "with every parameter, whatever it means. Held out, it is that of realizations that the model "
    "was not identified from: compare methods by this one. For this, adaptive keeps the smooth "
    "part and the number of switches that it found in all realizations, and fits their amplitudes "
    "and places anew. Noise of the torque, which nothing predicts, keeps both below 100 %. A high "
    "VAF does not make a stiffness right: a reflex that is taken for stiffness is predicted too."
)


def illustrations(account: Account) -> dict[str, Illustration]:
    """Return the answer, estimates over a variable, and a comparison if methods are several."""
    found, label = account.found, account.found.leading
    withdrawn = account.trust.level == "none"
    shown = {} if withdrawn else {"answer": {label: found.models[label]}}
    shown |= {"methods": dict(found.models)} if withdrawn or len(found.models) > 1 else {}
    titles = {
        "answer": f"Impedance over time by {label}",
        "methods": "Impedance over time by all methods",
    }
    vaf, variable = found.time_varying_vaf, variable_of(found.models, found.ensemble)
    below = ", and the time-varying VAF" if vaf else ""
    drawn = {}
    for stem, models in shown.items():
        *names, last = (name.replace("_", " ") for name in drawn_quantities(models, variable))
        what = f"{', '.join(names)} and {last}"
        text = f"{what.capitalize()} by {label}" if stem == "answer" else f"Each method’s {what}"
        picture = partial(identified_impedance, models, vaf, but_over=variable)
        drawn[stem] = Illustration(picture, titles[stem], f"{text}, with 95 % bands{below}.")
    if not variable or withdrawn:
        return drawn
    text = (
        f"Quantities that follow {variable}, with 95 % bands, above how long {variable} was near "
        "each of its values."
    )
    picture = partial(scheduled_estimates, found.models, found.ensemble, variable)
    return {
        "answer": drawn.pop("answer"),
        "variable": Illustration(picture, f"Estimates over {variable}", text),
    } | drawn


def outcome(account: Account, figures: list[page.Block]) -> page.Section:
    """Return the answer in a box, in pictures and in numbers."""
    found, trust, label = account.found, account.trust, account.found.leading
    first, *rest = answer(account)
    lines = [sentence(first), *([" ".join(map(sentence, rest))] if rest else [])]
    if trust.level == "none":
        blocks: list[page.Block] = [page.Box([*lines, _judged(account)]), *figures]
        return page.Section("outcome", "No stiffness is stated", blocks, contents="Stiffness")
    lines += [*filter(None, [why_leading(account)]), *_differing(account), _trust(account)]
    band = ADAPTIVE_BAND if isinstance(found.models[label], AdaptiveModel) else BAND
    blocks = [page.Box(lines), band, *figures, *_quantities(account), *_switches(account)]
    return page.Section("outcome", "The stiffness to report", blocks, contents="Stiffness")


def _differing(account: Account) -> list[str]:
    """Describe the mean results of the other methods, and where the page explains them."""
    from markupsafe import Markup  # noqa: PLC0415  # only a page needs it

    if not (means := others(account.found)):
        return []
    blamed = with_reflex(account)
    who = "all" if len(blamed) == len(account.found.models) - 1 else ", ".join(blamed)
    told = f" ({who} have one pathway, which takes a reflex for stiffness)" if blamed else ""
    text = 'By the other methods it is {} on average{}; <a href="#methods">why they differ</a>.'
    return [Markup(text).format(means, told)]


def _trust(account: Account) -> str:
    """Describe held-out VAF and diagnosis in a sentence each."""
    held_out, inside = (
        account.held_out_mean(account.found.leading),
        mean_of(account.found.vaf[account.found.leading]),
    )
    sentences = []
    if math.isfinite(held_out):
        where = account.where_held_out
        sentences.append(
            f"It predicts {held_out:.1f} % of the torque’s variance in {where} that were held out."
        )
    elif math.isfinite(inside):
        sentences.append(
            f"It predicts {inside:.1f} % of the variance of the torque that it was identified from."
        )
    return " ".join([*sentences, _judged(account)])


def _judged(account: Account) -> str:
    """Return the diagnosis in a sentence."""
    if account.diagnosis is None:
        return f"The data were not diagnosed: {account.undiagnosed}."
    titles = ", ".join(each.fault.title.lower() for each in account.diagnosis.findings)
    return f"Diagnosis of the data: {account.diagnosis.verdict}{': ' if titles else ''}{titles}."


def _quantities(account: Account) -> list[page.Block]:
    """Return a table of every quantity over time by the leading method."""
    found, label = account.found, account.found.leading
    model, rows = found.models[label], []
    for name, (lower, upper) in found.bands[label].items():
        values = model.over_time(name)
        if not np.isfinite(values).any():
            continue
        low, high = int(np.nanargmin(values)), int(np.nanargmax(values))
        ends = [
            cell
            for at in (low, high)
            for cell in (page.number(values[at]), page.number(model.time[at], decimals=2))
        ]
        unit = IMPEDANCE_UNITS.get(name) or unit_name(model.estimates[name].unit)
        half = page.number(mean_of(upper - lower) / 2)
        rows.append(
            page.Row((name.replace("_", " "), unit, page.number(mean_of(values)), half, *ends))
        )
    caption = (
        f"By {label}: mean over time, half width of the pointwise 95 % band (also its mean), and "
        "both extremes."
    )
    columns = [page.Column("quantity"), page.Column("unit")]
    columns += [page.Column(heading, kind="number") for heading in ("mean", "95 % band, ±")]
    for end in ("lowest", "highest"):
        columns += [page.Column(end, kind="number"), page.Column("at", "s", "number")]
    return [page.Table("What to report", caption, columns, rows, narrow=True)] if rows else []


def _switches(account: Account) -> list[page.Block]:
    """Return tables of the sudden changes that the leading method found, likely and unlikely."""
    model = account.found.models[account.found.leading]
    rows: dict[bool, list[page.Row]] = {True: [], False: []}
    for name in IMPEDANCE_UNITS:
        for each in switches(model, name):
            cells = (
                name,
                page.number(each.time, decimals=3),
                f"{each.earliest:.3f} to {each.latest:.3f}",
                page.number(each.size, 1.96 * each.size_error, 1 if name == "stiffness" else 3),
                page.number(100 * each.probability, decimals=0),
            )
            rows[each.probability > 0.5].append(page.Row(cells))
    told = "when, most probably between which times (95 %), and by how much (± its 95 % band)."
    captions = {
        True: f"Sudden changes: {told}",
        False: f"More likely no sudden change than one, but if there is: {told}",
    }
    columns = [
        page.Column("quantity"),
        page.Column("at", "s", "number"),
        page.Column("between", "s", "number"),
    ]
    columns += [page.Column("change", kind="number"), page.Column("probability", "%", "number")]
    labels = {True: "Switches", False: "Switches that are unlikely"}
    return [
        page.Table(labels[there], captions[there], columns, rows[there], narrow=True)
        for there in rows
        if rows[there]
    ]
