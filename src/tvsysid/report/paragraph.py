"""What was done, as a paragraph for a paper's section on methods, with its bibliography."""

from __future__ import annotations

import math

import numpy as np

from tvsysid import __version__
from tvsysid.comparison.comparison import FOLDS
from tvsysid.methods.base import Method
from tvsysid.methods.references import bibliography, cited
from tvsysid.methods.tuning.evidence import Tuned
from tvsysid.numerics.bands import mean_of
from tvsysid.recommendation.trust import negative_reflex, reflex_shown
from tvsysid.report.answer import Account, one_pathway, reflex_found
from tvsysid.report.page import template
from tvsysid.validators import settings_of as setting_values


def methods_paragraph(account: Account) -> str:
    """Return a paragraph on data, methods, settings and results, with citations."""
    found, label = account.found, account.found.leading
    ensemble, model = found.ensemble, found.models[label]
    lower, upper = found.bands[label]["stiffness"]
    labels = [label, *(each for each in found.models if each != label)]
    text = template("paragraph.txt").render(
        version=__version__,
        paper=cited(["vanderuit2021"]).strip("()"),
        account=account,
        found=found,
        ensemble=ensemble,
        diagnosis=account.diagnosis,
        rate=ensemble.sampling_rate,
        ratio=ensemble.angle_as_recorded.shape[-1],
        trials=len(np.unique(np.asarray(ensemble.trials))),
        label=label,
        methods=[_named(found.methods[each]) for each in labels],
        stiffness=model.stiffness[np.isfinite(model.stiffness)],
        band=_known(mean_of(upper - lower) / 2),
        held_out=_known(account.held_out_mean(label)),
        in_sample=_known(mean_of(found.vaf[label])),
        folds=min(FOLDS, len(ensemble)),
        one_pathway=one_pathway(found),
        reflex_found=reflex_found(account),
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


def _named(method: Method) -> str:
    """Describe a method with its settings and citation."""
    details = "; ".join(filter(None, (settings_of(method), cited(method.cites).strip("()"))))
    name = f"{method.title[:1].lower()}{method.title[1:]}"
    return f"{name} ({method.key}{': ' if details else ''}{details})"


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
