"""Page of one identification: the stiffness to report, its reasons and its trustworthiness."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from tvsysid.comparison.comparison import FOLDS
from tvsysid.errors import by_text
from tvsysid.figures import (
    Illustration,
    draw_all,
    identified_impedance,
    scheduled_estimates,
    variable_of,
)
from tvsysid.methods.base import Method
from tvsysid.methods.references import bibliography, cited
from tvsysid.methods.tuning.evidence import Tuned
from tvsysid.recommendation.trust import negative_reflex, reflex_shown
from tvsysid.report.answer import Account, answer, estimates, further
from tvsysid.report.page import filled, render
from tvsysid.validators import settings_of as setting_values


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
    table = estimates(found)
    methods = found.summary().assign(held_out=[*map(account.held_out_mean, found.models)])
    warned = (
        (label, text)
        for label, model in found.models.items()
        for text in model.diagnostics.warnings
    )
    problems = [
        *((label, "failed", why) for label, why in found.failed.items()),
        *((label, "skipped", why) for label, why in found.skipped.items()),
        *((", ".join(labels), "warning", text) for text, labels in by_text(warned).items()),
    ]
    render(
        path,
        "identification.html",
        **account.values,
        lines=answer(account),
        pictures=draw_all(figures or illustrations(account)),
        quantities=table[(table.method == label) & table["lowest at (s)"].notna()],
        further=further(found),
        switches=getattr(found.models[label], "switches", ()),
        methods=methods,
        settings=settings_of,
        problems=problems,
        paragraph=methods_paragraph(account),
        bibliography=methods_bibliography(account),
        command=command,
    )


def illustrations(account: Account) -> dict[str, Illustration]:
    """Return the answer, estimates over a variable, and a comparison if methods are several."""
    found, label = account.found, account.found.leading
    vaf, variable = found.time_varying_vaf, variable_of(found.models, found.ensemble)
    below = ", and the time-varying VAF" if vaf else ""

    def impedance(whose: str, labels: list[str]) -> Illustration:
        models = {each: found.models[each] for each in labels}
        draw = partial(identified_impedance, models, vaf, but_over=variable)
        text = f"Every quantity that was estimated {whose}, with 95 % bands{below}."
        return Illustration(draw, f"Impedance over time {whose}", text)

    drawn = {}
    if account.trust.level != "none":
        drawn["answer"] = impedance(f"by {label}", [label])
        if variable:
            draw = partial(scheduled_estimates, found.models, found.ensemble, variable)
            text = (
                f"Quantities that follow {variable}, with 95 % bands, above how long {variable} "
                "was near each of its values."
            )
            drawn["variable"] = Illustration(draw, f"Estimates over {variable}", text)
    if not drawn or len(found.models) > 1:
        drawn["methods"] = impedance("by all methods", list(found.models))
    return drawn


def methods_paragraph(account: Account) -> str:
    """Return a paragraph on data, methods, settings and results, with citations."""
    found, model = account.found, account.found.models[account.found.leading]
    text = filled(
        "paragraph.txt",
        **account.values,
        cited=cited,
        settings=settings_of,
        folds=min(FOLDS, len(found.ensemble)),
        reflex_shown=reflex_shown(model),
        negative=negative_reflex(model),
    )
    return " ".join(text.split())


def methods_bibliography(account: Account) -> str:
    """Return the BibTeX entries of all citations of the paragraph."""
    keys = [key for method in account.found.methods.values() for key in method.cites]
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
