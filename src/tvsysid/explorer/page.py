"""The page: native form controls, which keyboards and screen readers know, and the results."""

from __future__ import annotations

import asyncio
import base64
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
from shiny import App, Inputs, reactive, render, ui

from tvsysid.errors import InputError, describe_error
from tvsysid.explorer.outcome import Outcome, in_turn, outcome
from tvsysid.explorer.settings import Settings, method_parts, method_settings, settings_from
from tvsysid.methods import describe, names
from tvsysid.recordings.reading import AngleUnit, Columns, TorqueUnit

QUANTITIES = ("stiffness", "viscosity", "inertia", "reflex_gain")
BANDS = {"pointwise": "95 % at each time by itself", "simultaneous": "95 % at all times together"}
UNITS_AND_COLUMNS = {
    "angle_unit": ("Unit of the angle", AngleUnit),
    "torque_unit": ("Unit of the torque", TorqueUnit),
    "columns": ("Columns of a matrix", Columns),
}
PAUSE_S = 0.15  # a further key within it replaces the choice before
MAX_TIMES = 11  # rows in the table of values over time
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


def page(settings: Settings, channels: Mapping[str, str]) -> App:
    """Return the application, which begins with some settings.

    ``channels`` are labels of a file's channels, by name.
    """
    key, typed = method_parts(settings.method)
    methods = {key: method_settings(key)}
    for name in names():
        with suppress(InputError):  # an installed method that cannot be loaded
            methods[name] = method_settings(name)
    from_file = isinstance(settings.source, Path)
    title = settings.source.name if isinstance(settings.source, Path) else "recording"
    controls = ui.div(
        *([_reading(settings, channels)] if from_file else []),
        _cutting(settings),
        _method(key, typed, methods),
        _group(
            "Picture",
            ui.input_select(
                "quantity", "Quantity", {name: name.replace("_", " ") for name in QUANTITIES}
            ),
            ui.input_select("band", "Band", BANDS),
        ),
    )
    widths: Any = {"sm": 12, "md": (4, 8)}
    layout = ui.layout_columns(controls, _results(), col_widths=widths)
    return App(
        ui.page_fluid(
            ui.head_content(ui.tags.style(STYLE), ui.tags.link(rel="icon", href="data:,")),
            ui.tags.main(ui.h1(title, class_="h3"), layout, class_="container-fluid"),
            ui.tags.header(ui.input_dark_mode(), class_="container-fluid text-end"),
            title=f"{title} · tvsysid explore",
            lang="en",
        ),
        _server(settings, methods),
    )


def _reading(settings: Settings, channels: Mapping[str, str]) -> ui.Tag:
    reading, choices = settings.reading, {"": "choose a channel", **channels}
    return _group(
        "Recording",
        ui.input_select("angle", "Angle", choices, selected=reading.angle or ""),
        ui.input_select("torque", "Torque", choices, selected=reading.torque or ""),
        _number("sampling_rate", "Sampling rate (Hz)", reading.sampling_rate),
        ui.input_checkbox("reversed", "Reverse the torque's sign", reading.torque_sign == -1),
        ui.tags.details(
            ui.tags.summary("Units and columns"),
            *(
                ui.input_select(name, label, list(get_args(kind)), selected=getattr(reading, name))
                for name, (label, kind) in UNITS_AND_COLUMNS.items()
            ),
        ),
    )


def _cutting(settings: Settings) -> ui.Tag:
    cutting = settings.cutting
    return _group(
        "Realizations",
        _number("period", "Period (s)", cutting.period),
        _number("decimate", "Decimate to (Hz; empty for not)", cutting.decimate),
        _number("context", "Context on either side (s)", cutting.context),
        ui.input_checkbox(
            "align_channels", "Correct a delay of the torque", settings.align_channels
        ),
    )


def _method(key: str, typed: Mapping[str, str], methods: Mapping[str, Mapping[str, str]]) -> ui.Tag:
    groups: dict[str, dict[str, str]] = {}
    for name in methods:
        about = describe(name)
        groups.setdefault(about.purpose, {})[name] = f"{name}: {about.title}"
    settings = [
        ui.panel_conditional(
            f"input.method === {json.dumps(name)}",
            *(
                ui.input_text(
                    _setting(place, setting),
                    f"{setting} ({_default(usual)})",
                    typed.get(setting, "") if name == key else "",
                    update_on="blur",
                )
                for setting, usual in own.items()
            ),
        )
        for place, (name, own) in enumerate(methods.items())
    ]
    return _group("Method", ui.input_select("method", "Method", groups, selected=key), *settings)


def _default(usual: str) -> str:
    return {"": "must be given", "None": "optional"}.get(usual, f"{usual} unless given")


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
    """Return the outputs. Only the answer and the diagnosis are announced when they change."""
    outputs = {
        name: ui.output_ui(name) for name in ("answer", "picture", "judged", "numbers", "again")
    }
    for name in ("picture", "numbers", "again"):
        outputs[name].attrs["aria-live"] = "off"
    return ui.tags.section(ui.h2("Result"), *outputs.values(), aria_label="Result")


def _server(start: Settings, methods: Mapping[str, Mapping[str, str]]) -> Callable[[Inputs], None]:
    places = {name: place for place, name in enumerate(methods)}
    inputs = ["period", "decimate", "context", "align_channels", "method"]
    if isinstance(start.source, Path):
        inputs += ["angle", "torque", "sampling_rate", "reversed", *UNITS_AND_COLUMNS]

    def server(input: Inputs) -> None:
        @reactive.extended_task
        async def work(
            controls: dict[str, Any], quantity: str, simultaneous: bool
        ) -> Outcome | str:
            await asyncio.sleep(PAUSE_S)
            return await in_turn(_outcome, start, controls, quantity, simultaneous)

        @reactive.effect
        def _start() -> None:
            controls = {name: input[name]() for name in inputs}
            key = controls["method"]
            controls["settings"] = {
                name: input[_setting(places[key], name)]() for name in methods.get(key, {})
            }
            work.cancel()
            work.invoke(controls, input.quantity(), input.band() == "simultaneous")

        @render.ui
        def answer() -> ui.Tag | ui.TagList:
            if work.status() == "running":
                return ui.p(f"Identifying by {input.method()} …")
            found = work.result()
            if isinstance(found, str):
                return ui.div(found, class_="alert alert-danger")
            notes = [ui.p(f"Warning: {each}", class_="alert alert-warning") for each in found.notes]
            return ui.TagList(*map(ui.p, found.lines), *notes)

        def shown(draw: Callable[[Outcome], ui.TagChild]) -> Callable[[], ui.TagChild]:
            def output() -> ui.TagChild:
                found = work.result()
                return None if isinstance(found, str) else draw(found)

            output.__name__ = draw.__name__
            return output

        @render.ui
        @shown
        def picture(found: Outcome) -> ui.TagChild:
            return _figure(found, input.quantity())

        render.ui(shown(judged))
        render.ui(shown(numbers))
        render.ui(shown(again))

    return server


def _outcome(
    start: Settings, controls: dict[str, Any], quantity: str, simultaneous: bool
) -> Outcome | str:
    """Return the outcome of the controls' settings, or the error."""
    try:
        return outcome(settings_from(controls, start), quantity, simultaneous)
    except InputError as error:
        return str(error)
    except Exception as error:  # a user's method may raise anything
        return f"Unexpected error: {describe_error(error)}"


def judged(found: Outcome) -> ui.TagChild:
    """Return the recommended method and the diagnosis."""
    method = ui.p(f"Method for these data: {found.found.recommendation.sentence}.")
    diagnosis = found.diagnosis
    if isinstance(diagnosis, str):
        return ui.TagList(method, ui.p(f"No diagnosis: {diagnosis}"))
    faults = [
        ui.p(f"{each.fault.title}: {each.what}; {each.fault.remedy}") for each in diagnosis.findings
    ]
    details = ui.tags.details(ui.tags.summary("What was found, and what to do"), *faults)
    return ui.TagList(method, ui.p(f"Diagnosis: {diagnosis.verdict}."), details if faults else None)


def _figure(found: Outcome, quantity: str) -> ui.Tag:
    source = "data:image/svg+xml;base64," + base64.b64encode(found.picture).decode()
    (model,), words = found.found.models.values(), quantity.replace("_", " ")
    text = f"{words} over a realization with its 95 % band; the tables below have the numbers"
    if quantity not in model.estimates or not np.isfinite(model.estimates[quantity].values).any():
        text = f"{words} is not identified by this method"
    image = ui.img(src=source, alt=text, width=614, height=326)
    return ui.tags.figure(image, class_="scroll", tabindex="0", aria_label="picture, scrolling")


def numbers(found: Outcome) -> ui.TagChild:
    """Return the table of the command line, and values over time."""
    over_time = found.found.over_time().drop(columns="method")
    every = max(1, len(over_time) // (MAX_TIMES - 1))
    summary = found.found.summary().set_index("method").T
    return ui.TagList(
        ui.HTML(
            _html(summary.rename(index=lambda name: name.replace("half_band", "95 % band, ±")))
        ),
        ui.tags.details(
            ui.tags.summary("Values over time (SI units)"),
            ui.HTML(_html(over_time.iloc[::every].set_index("time_s"))),
        ),
    )


def _html(table: pd.DataFrame) -> str:
    shown = table.to_html(float_format="{:.4g}".format, na_rep="", border=0)
    return f'<div class="scroll" tabindex="0">{shown}</div>'


def again(found: Outcome) -> ui.TagChild:
    """Return the command and the Python code that repeat the analysis, to copy."""
    texts = {
        "On the command line": found.settings.command,
        "In Python": found.settings.python(found.prepared),
    }
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
