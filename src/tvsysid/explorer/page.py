"""The page: controls, and what is shown of an outcome.

Native elements of a form, which keyboards and readers know.
"""

from __future__ import annotations

import asyncio
import base64
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import attrs
import numpy as np
from shiny import App, Inputs, reactive, render, ui

from tvsysid.errors import InputError, describe_error
from tvsysid.explorer.outcome import Outcome, in_turn, outcome
from tvsysid.explorer.settings import CHOICES, Source, method_parts, method_settings, settings_from
from tvsysid.methods import describe, names
from tvsysid.report.page import Block, Column, Fold, Row, Table, html, number
from tvsysid.signals import Recording

QUANTITIES = ("stiffness", "viscosity", "inertia", "reflex_gain")
BANDS = {"pointwise": "95 % at each time by itself", "simultaneous": "95 % at all times together"}
PAUSE_S = 0.15  # in which a further key takes the place of what the one before chose
TIMES = 11  # in the table of values over time
STYLE = """
body { padding: 1rem 0; overflow-wrap: anywhere }
fieldset { margin-bottom: 1.25rem }
legend, h2 { font-size: 1.15rem; font-weight: 600 }
.shiny-input-container { width: 100% !important }
:focus-visible { outline: 3px solid #c2410c !important; outline-offset: 2px }
[data-bs-theme=dark] :focus-visible { outline-color: #ff9d4d !important }
figure img { background: #fff; width: 100%; height: auto }
@media (max-width: 576px) { figure img { width: 38rem } }
[data-bs-theme=dark] figure img { filter: brightness(.8) contrast(1.2) }
textarea { font: .85rem var(--bs-font-monospace); width: 100%; margin-bottom: .75rem; \
field-sizing: content }
.unseen { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%) }
.scroll { overflow-x: auto; position: relative }
th, td { padding: .15rem .75rem .15rem 0; font-variant-numeric: tabular-nums }
caption { caption-side: top }
table { overflow-wrap: normal }
summary { margin: .5rem 0 }
.recalculating { opacity: .8 !important }
"""


@attrs.frozen
class Shown:
    """An outcome and its picture, or the error in their place."""

    found: Outcome | None = None
    picture: bytes = b""
    error: str = ""
    kind: str = "danger"


class Judged(NamedTuple):
    """The answer's lines for an outcome; as HTML, the recommended method and the diagnosis."""

    shown: Shown
    lines: Sequence[str] = ()
    details: str = ""


def page(name: str, source: Source, given: Mapping[str, Any], channels: Mapping[str, str]) -> App:
    """Return the application for a recording, or a file and its ``channels`` with labels.

    ``given`` are the controls' values.
    """
    key, typed = method_parts(given["method"])
    every = _methods(key)
    reading = [] if isinstance(source, Recording) else [_reading(given, channels)]
    title = f"{name} · tvsysid explore"
    controls = ui.div(*reading, _cutting(given), _method(key, typed, every), _picture())
    widths: Any = {"sm": 12, "md": (4, 8)}
    layout = ui.layout_columns(controls, _results(), col_widths=widths)
    body = ui.tags.main(ui.h1(name, class_="h3"), layout, class_="container-fluid")
    header = ui.tags.header(ui.input_dark_mode(), class_="container-fluid text-end")
    head = ui.head_content(ui.tags.style(STYLE), ui.tags.link(rel="icon", href="data:,"))
    return App(ui.page_fluid(head, body, header, title=title, lang="en"), _server(source, every))


def _methods(first: str) -> dict[str, dict[str, str]]:
    """Return the settings of each method."""
    found = {first: method_settings(first)}  # raises for one that is not known
    for key in names():
        with suppress(InputError):  # an installed one that cannot be loaded
            found[key] = method_settings(key)
    return found


def _reading(given: Mapping[str, Any], channels: Mapping[str, str]) -> ui.Tag:
    choices = {"": "choose a channel", **channels}
    more = {
        "angle_unit": "Unit of the angle",
        "torque_unit": "Unit of the torque",
        "columns": "Columns of a matrix",
    }
    return _group(
        "Recording",
        ui.input_select("angle", "Angle", choices, selected=given["angle"] or ""),
        ui.input_select("torque", "Torque", choices, selected=given["torque"] or ""),
        _number("rate", "Sampling rate (Hz)", given["rate"]),
        ui.input_checkbox("reversed", "Reverse the torque's sign", given["torque_sign"] == -1),
        ui.tags.details(
            ui.tags.summary("Units and columns"),
            *(
                ui.input_select(name, label, list(CHOICES[name]), selected=given[name])
                for name, label in more.items()
            ),
        ),
    )


def _cutting(given: Mapping[str, Any]) -> ui.Tag:
    return _group(
        "Realizations",
        _number("period", "Period (s)", given["period"]),
        _number("decimate", "Decimate to (Hz; empty for not)", given["decimate"]),
        _number("context", "Context on either side (s)", given["context"]),
        ui.input_checkbox(
            "align_channels", "Correct a delay of the torque", given["align_channels"]
        ),
    )


def _method(key: str, typed: Mapping[str, str], every: Mapping[str, Mapping[str, str]]) -> ui.Tag:
    groups: dict[str, dict[str, str]] = {}
    for name in every:
        about = describe(name)
        groups.setdefault(about.purpose, {})[name] = f"{name}: {about.title}"
    settings = [
        ui.panel_conditional(
            f"input.method === {json.dumps(name)}",
            *(
                ui.input_text(
                    _setting(place, setting),
                    f"{setting} ({_unless(usual)})",
                    typed.get(setting, "") if name == key else "",
                    update_on="blur",
                )
                for setting, usual in own.items()
            ),
        )
        for place, (name, own) in enumerate(every.items())
    ]
    return _group("Method", ui.input_select("method", "Method", groups, selected=key), *settings)


def _unless(usual: str) -> str:
    return {"": "must be given", "None": "optional"}.get(usual, f"{usual} unless given")


def _picture() -> ui.Tag:
    quantities = {name: name.replace("_", " ") for name in QUANTITIES}
    return _group(
        "Picture",
        ui.input_select("quantity", "Quantity", quantities),
        ui.input_select("band", "Band", BANDS),
    )


def _setting(place: int, name: str) -> str:
    """Return the identifier of the control for a setting of a method."""
    return f"setting_{place}_{name}"


def _group(legend: str, *controls: ui.TagChild) -> ui.Tag:
    return ui.tags.fieldset(ui.tags.legend(legend), *controls)


def _number(name: str, label: str, value: float | None) -> ui.Tag:
    value = int(value) if value is not None and float(value).is_integer() else value
    # None leaves it empty.
    return ui.input_numeric(name, label, value, update_on="blur")  # type: ignore[arg-type]


def _results() -> ui.Tag:
    """Return the content of the page for an outcome.

    Only the answer and the diagnosis are announced when they change.
    """
    silent = [ui.output_ui(name) for name in ("picture", "numbers", "again")]
    for each in silent:
        each.attrs["aria-live"] = "off"
    picture, numbers, again = silent
    return ui.tags.section(
        ui.h2("Result"),
        ui.output_ui("answer"),
        picture,
        ui.output_ui("judged"),
        numbers,
        again,
        aria_label="Result",
    )


def _server(source: Source, every: Mapping[str, Mapping[str, str]]) -> Callable[[Inputs], None]:
    places = {name: place for place, name in enumerate(every)}
    controls = ["period", "decimate", "context", "align_channels", "method"]
    if not isinstance(source, Recording):
        controls += ["angle", "torque", "angle_unit", "torque_unit", "columns", "rate", "reversed"]

    def server(input: Inputs) -> None:
        @reactive.extended_task
        async def work(said: dict[str, Any], quantity: str, simultaneous: bool) -> Shown:
            await asyncio.sleep(PAUSE_S)
            return await in_turn(_shown, source, said, quantity, simultaneous)

        @reactive.extended_task
        async def judge(shown: Shown) -> Judged:
            return await in_turn(_judged, shown)

        @reactive.effect
        def _start() -> None:
            said = {name: input[name]() for name in controls}
            own = every.get(said["method"], {})
            said["settings"] = {
                name: input[_setting(places[said["method"]], name)]() for name in own
            }
            work.cancel()
            work.invoke(said, input.quantity(), input.band() == "simultaneous")

        @reactive.effect
        def _then() -> None:
            shown = work.result()
            judge.cancel()
            judge.invoke(shown)

        @render.ui
        def answer() -> ui.Tag | ui.TagList:
            if work.status() == "running":
                return ui.p(f"Identifying by {input.method()} …")
            shown = work.result()
            if shown.found is None:
                return ui.div(shown.error, class_=f"alert alert-{shown.kind}")
            if judge.status() == "running" or judge.result().shown is not shown:
                return ui.p("Checking the data …")
            notes = [
                ui.p(f"Warning: {text}", class_="alert alert-warning") for text in shown.found.notes
            ]
            return ui.TagList(*map(ui.p, judge.result().lines), *notes)

        @render.ui
        def picture() -> ui.Tag | None:
            return _figure(work.result(), input.quantity())

        @render.ui
        def judged() -> ui.HTML:
            return ui.HTML(judge.result().details)

        @render.ui
        def numbers() -> ui.HTML:
            return ui.HTML(_tables(work.result().found))

        @render.ui
        def again() -> ui.TagList | None:
            return _again(work.result().found)

    return server


def _shown(source: Source, said: dict[str, Any], quantity: str, simultaneous: bool) -> Shown:
    """Return the outcome of the controls' settings. Errors are shown on the page."""
    try:
        settings = settings_from(said, source)
    except InputError as error:  # not all is chosen yet
        return Shown(error=str(error), kind="info")
    try:
        found = outcome(settings)
        return Shown(found, found.picture(quantity, simultaneous))
    except InputError as error:
        return Shown(error=str(error))
    except Exception as error:  # a method of one's own may raise anything
        return Shown(error=f"this is not expected: {describe_error(error)}")


def _judged(shown: Shown) -> Judged:
    if shown.found is None:
        return Judged(shown)
    diagnosis = shown.found.diagnosis
    blocks: list[Block] = [f"Method for these data: {shown.found.found.recommendation.sentence}."]
    if isinstance(diagnosis, str):
        blocks.append(f"No diagnosis: {diagnosis}")
    else:
        blocks.append(f"Diagnosis: {diagnosis.verdict}.")
        found = [
            f"{each.fault.title}: {each.what}; {each.fault.remedy}" for each in diagnosis.findings
        ]
        blocks += [Fold("What was found, and what to do", found)] if found else []
    return Judged(shown, shown.found.lines, html(blocks))


def _figure(shown: Shown, quantity: str) -> ui.Tag | None:
    if shown.found is None:
        return None
    source = "data:image/svg+xml;base64," + base64.b64encode(shown.picture).decode()
    (model,), words = shown.found.found.models.values(), quantity.replace("_", " ")
    text = f"{words} over a realization with its 95 % band; the tables below have the numbers"
    if quantity not in model.estimates or not np.isfinite(model.estimates[quantity].values).any():
        text = f"{words} is not identified by this method"
    image = ui.img(src=source, alt=text, width=614, height=326)
    return ui.tags.figure(image, class_="scroll", tabindex="0", aria_label="picture, scrolling")


def _tables(found: Outcome | None) -> str:
    """Return the picture in numbers: the text of the command line, and values over time."""
    if found is None:
        return ""
    summary = found.found.summary().iloc[0]
    rows = [
        Row([str(name).replace("half_band", "95 % band, ±"), number(value)])
        for name, value in list(summary.items())[1:]
    ]
    short = Table(
        "summary", "In numbers", [Column("quantity"), Column("value", kind="number")], rows
    )
    over = found.found.over_time().drop(columns="method")
    some = over.iloc[:: max(1, len(over) // (TIMES - 1))]
    heads = [Column(name.replace("_", " "), kind="number") for name in some.columns]
    cells = [Row([number(value) for value in row]) for row in some.itertuples(index=False)]
    return html(
        [short, Fold("Values over time", [Table("values over time", "SI units", heads, cells)])]
    )


def _again(found: Outcome | None) -> ui.TagList | None:
    if found is None:
        return None
    texts = {"On the command line": found.command, "In Python": found.python}
    areas = [
        (ui.tags.label(label, for_=f"again{place}"), _area(f"again{place}", text))
        for place, (label, text) in enumerate(texts.items())
        if text
    ]
    return ui.TagList(ui.h2("The same again"), *areas)


def _area(name: str, text: str) -> ui.Tag:
    rows = sum(1 + len(line) // 70 for line in text.split("\n"))
    return ui.tags.textarea(
        text, id=name, rows=rows, readonly="", onfocus="this.select()", class_="form-control"
    )
