"""Run one block of code of the page. Return its output, its error and the curves to draw.

An error includes its position. The same code runs in the browser's worker and in the tests.
"""

import io
import json
import traceback
import warnings
from collections.abc import Mapping
from contextlib import redirect_stdout
from typing import Any

import numpy as np

import tvsysid as tv

CELL = "<cell>"


def run(code: str) -> str:
    """Run the code; JSON with ``text``, ``error`` (None or words) and ``curves``."""
    scope: dict[str, Any] = {"__name__": "__main__"}
    said, error = io.StringIO(), None
    with redirect_stdout(said), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", tv.DataQualityWarning)
        warnings.showwarning = lambda message, *_, **__: print(f"Warning: {message}")
        try:
            exec(compile(code, CELL, "exec"), scope)
            found = curves(scope)
        except BaseException as fault:  # SystemExit too: nothing that is typed ends the worker
            error, found = words(fault), []
    return json.dumps({"text": said.getvalue(), "error": error, "curves": found})


def words(fault: BaseException) -> str:
    """Line, kind and message of an error."""
    lines = [
        frame.lineno
        for frame in traceback.extract_tb(fault.__traceback__)
        if frame.filename == CELL
    ]
    if isinstance(fault, SyntaxError) and fault.filename == CELL:
        lines, fault = [fault.lineno], type(fault)(fault.msg)
    return f"{f'Line {lines[-1]}: ' if lines else ''}{type(fault).__name__}: {fault}"


def curves(scope: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the stiffness of ``models`` (by name) or ``model``, with bands.

    The truth of ``simulation`` is added if ``ensemble`` was cut from it.
    """
    models = scope.get("models", {"estimate": scope["model"]} if "model" in scope else {})
    simulation, ensemble = scope.get("simulation"), scope.get("ensemble")
    truth = None
    if isinstance(simulation, tv.simulate.Simulation) and isinstance(ensemble, tv.Ensemble):
        truth = simulation.truth_of(ensemble)["stiffness"][0]
    found = [
        curve(str(name), model, truth)
        for name, model in (models.items() if isinstance(models, Mapping) else ())
        if isinstance(model, tv.Model)
        and "stiffness" in model.estimates
        and np.isfinite(model.stiffness).any()
    ]
    if truth is not None and found:
        found.append({"name": "truth", "time": ensemble.time.tolist(), "values": numbers(truth)})
    return found


def curve(name: str, model: tv.Model, truth: Any) -> dict[str, Any]:
    """Return one model's stiffness, its 95 % band, and how often the band holds the truth."""
    lower, upper = model.estimates["stiffness"].band()
    known = np.isfinite(lower) & np.isfinite(upper)
    holds = None
    if truth is not None and truth.shape == lower.shape and known.any():
        holds = float(np.mean(((lower <= truth) & (truth <= upper))[known]))
    edges = {"lower": numbers(lower), "upper": numbers(upper)} if known.any() else {}
    return {
        "name": name,
        "time": model.time.tolist(),
        "values": numbers(model.stiffness),
        "holds": holds,
    } | edges


def numbers(values: Any) -> list[float | None]:
    """As JSON has them: None for what is no number."""
    return [float(value) if np.isfinite(value) else None for value in values]
