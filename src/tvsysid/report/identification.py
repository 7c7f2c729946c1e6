"""Page of one identification: the stiffness to report, its reasons and its trustworthiness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from tvsysid.comparison.comparison import FOLDS, Comparison
from tvsysid.errors import by_cause
from tvsysid.figures import (
    Illustration,
    draw_all,
    held_out_prediction,
    identified_impedance,
    scheduled_estimates,
)
from tvsysid.methods.base import Method
from tvsysid.methods.references import bibliography, cited
from tvsysid.methods.tuning import Tuned
from tvsysid.numerics.bands import mean_of
from tvsysid.recommendation.answer import has_one_pathway, is_reflex_detected
from tvsysid.report.estimates import TIMES, estimates, further
from tvsysid.report.page import filled, render
from tvsysid.validators import settings_of as setting_values


def write_identification(
    path: str | Path,
    found: Comparison,
    command: str = "",
    *,
    source: Mapping[str, str] = MappingProxyType({}),
    corrections: Sequence[str] = (),
    figures: Mapping[str, Illustration] | None = None,
) -> None:
    """Write one HTML file that says what was identified and how, and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    found
        What was found.
    command
        What was typed, if it is to be mentioned.
    source
        Origin of the data, as rows of a table (``{"file": "ankle.mat", "angle": "angle"}``).
    corrections
        Corrections when the file was read (``["the torque's sign was reversed"]``).
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
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     tv.report.write_identification(f"{folder}/report.html", found)
    """
    table, label = estimates(found), found.answer.label
    warned = (
        (label, text)
        for label, model in found.models.items()
        for text in model.diagnostics.warnings
    )
    problems = [
        *((label, "failed", why) for label, why in found.failed.items()),
        *((label, "skipped", why) for label, why in found.skipped.items()),
        *((", ".join(labels), "warning", text) for text, labels in by_cause(warned).items()),
    ]
    render(
        path,
        "identification.html",
        answer=found.answer,
        found=found,
        ensemble=found.ensemble,
        diagnosis=found.recommendation.diagnosis,
        source=source,
        pictures=draw_all(figures or illustrations(found)),
        quantities=table[(table.method == label) & table.over.isin(TIMES)],
        further=further(found),
        switches=getattr(found.answer.model, "switches", ()),
        methods=found.summary().assign(held_out=[*found.answer.vaf.values()]),
        settings=settings_of,
        problems=problems,
        paragraph=methods_paragraph(found, corrections),
        bibliography=methods_bibliography(found),
        command=command,
    )


def illustrations(found: Comparison) -> dict[str, Illustration]:
    """Return the answer, estimates over a variable, all methods if several, and predictions."""
    answer, vaf, over = found.answer, found.time_varying_vaf, found.over_variables()
    channels = found.ensemble.channels
    variable = next((name for name in over.get("variable", ()) if name in channels), "")
    below = ", and the time-varying VAF" if vaf else ""

    def impedance(whose: str, labels: list[str], spread: ArrayLike = np.nan) -> Illustration:
        models = {each: found.models[each] for each in labels}
        draw = partial(identified_impedance, models, vaf, spread=spread)
        text = f"Every quantity that was estimated {whose}, with 95 % bands{below}."
        if np.isfinite(spread).any():
            text += " The lighter band shows how far methods differ."
        return Illustration(draw, f"Impedance over time {whose}", text)

    drawn = {}
    if answer.is_stated:
        drawn["answer"] = impedance(f"by {answer.label}", [answer.label], answer.spread)
        if variable:
            draw = partial(scheduled_estimates, found.models, found.ensemble, variable)
            text = (
                f"Quantities that follow {variable}, with 95 % bands, above how long {variable} "
                "was near each of its values."
            )
            drawn["variable"] = Illustration(draw, f"Estimates over {variable}", text)
    if not drawn or len(found.models) > 1:
        drawn["methods"] = impedance("by all methods", list(found.models))
    torques = found.held_out_torque.get(answer.label)
    if torques is not None and np.isfinite(torques).any():
        draw = partial(held_out_prediction, torques, found.ensemble.sampling_rate)
        text = (
            "Measured torque (deviation from the mean over realizations) and its prediction from "
            "the other realizations. Below, their difference and its autocorrelation. Values "
            "outside the band: the noise is coloured, or the model leaves something out."
        )
        drawn["held-out"] = Illustration(draw, f"Torque predicted by {answer.label}", text)
    return drawn


def methods_paragraph(found: Comparison, corrections: Sequence[str] = ()) -> str:
    """Return a paragraph on data, methods, settings and results, with citations."""
    text = filled(
        "paragraph.txt",
        answer=found.answer,
        found=found,
        ensemble=found.ensemble,
        diagnosis=found.recommendation.diagnosis,
        corrections=corrections,
        cited=cited,
        settings=settings_of,
        folds=min(FOLDS, len(found.ensemble)),
        in_sample=mean_of(found.vaf[found.answer.label]),
        reflex_detected=is_reflex_detected(found.answer.model),
        one_pathway=[
            label
            for label, model in found.models.items()
            if has_one_pathway(found.methods[label], model)
        ],
    )
    return " ".join(text.split())


def methods_bibliography(found: Comparison) -> str:
    """Return the BibTeX entries of all citations of the paragraph."""
    keys = [key for method in found.methods.values() for key in method.cites]
    return bibliography(["tvsysid", "vanderuit2021", *keys])


def settings_of(method: Method) -> str:
    """Return the settings of a method as used, such as ``max_lag=0.12, window=0.1``.

    Settings of None are left out: they turn something off, or let the method choose a value.
    """
    values = setting_values(method.method if isinstance(method, Tuned) else method)
    texts = {
        name: f"{value:.4g}" if isinstance(value, float) else str(value)
        for name, value in values.items()
        if value is not None
    }
    return ", ".join(f"{name}={text}" for name, text in texts.items())
