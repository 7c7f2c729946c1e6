"""What was done, as a paragraph for a paper's section on methods, with its bibliography."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tvsysid import __version__
from tvsysid.comparison.comparison import FOLDS
from tvsysid.figures.words import count
from tvsysid.methods.base import Method
from tvsysid.methods.references import bibliography, cited
from tvsysid.methods.tuning.evidence import Tuned
from tvsysid.numerics.bands import mean_of
from tvsysid.recommendation.trust import negative_reflex, reflex_shown
from tvsysid.report.answer import Account, one_pathway, reflex_found
from tvsysid.signals import Ensemble
from tvsysid.validators import settings_of as setting_values


def methods_paragraph(account: Account) -> str:
    """Return a paragraph on data, methods, settings and results, with citations."""
    found = account.found
    first, *others = (found.leading, *(label for label in found.models if label != found.leading))
    beside = (
        f"; for comparison by {_listed(_named(account, label) for label in others)}"
        if others
        else ""
    )
    sentences = [
        "Joint impedance was identified from a perturbation experiment with the software tvsysid, "
        f"version {__version__} (the tvsysid developers; see "
        f"{cited(['vanderuit2021']).strip('()')}).",
        *_data(found.ensemble),
        *([f"When the file was read, {' and '.join(account.turned)}."] if account.turned else []),
        *_perturbation(account),
        f"Stiffness, viscosity and inertia were estimated by {_named(account, first)}{beside}.",
        *_chosen(account),
        *_results(account, first),
        *_pathways(account, first),
        *_faults(account),
    ]
    return " ".join(sentences)


def methods_bibliography(account: Account) -> str:
    """Return the BibTeX entries of all citations of the paragraph."""
    keys = [key for method in account.found.methods.values() for key in method.cites]
    return bibliography(["tvsysid", "vanderuit2021", *keys])


def settings_of(method: Method) -> str:
    """Return the settings of a method as used, such as ``max_lag=0.12, window=0.1``.

    Empty where it has none.

    Those of None are left out: they turn something off, or let the method find a value.
    """
    own = method.method if isinstance(method, Tuned) else method
    values = setting_values(own)
    return ", ".join(
        f"{name}={_short(value)}" for name, value in values.items() if value is not None
    )


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _named(account: Account, label: str) -> str:
    """Describe a method with its settings and citation."""
    method = account.found.methods[label]
    title = method.title
    said = "; ".join(filter(None, (settings_of(method), cited(method.cites).strip("()"))))
    return f"{title[:1].lower()}{title[1:]} ({method.key}{': ' if said else ''}{said})"


def _listed(texts: Iterable[str]) -> str:
    *first, last = texts
    return f"{'; '.join(first)}; and {last}" if first else last


def _data(ensemble: Ensemble) -> list[str]:
    ratio = ensemble.angle_as_recorded.shape[-1]
    rate, trials = ensemble.sampling_rate, len(np.unique(np.asarray(ensemble.trials)))
    lowered = f", low-pass filtered and decimated to {rate:g} Hz" if ratio > 1 else ""
    cut = (
        f"Angle and torque, recorded at {rate * ratio:g} Hz in {count(trials, 'trial')}{lowered}, "
        f"were cut into {count(len(ensemble), 'realization')} of {ensemble.duration:g} s with "
        f"{ensemble.context / rate:g} s of context on either side"
    )
    lost = (
        f"; {count(ensemble.left_out, 'realization')} too near the ends of a trial for the context "
        "were left out"
    )
    sentences = [f"{cut}{lost if ensemble.left_out else ''}."]
    if ensemble.delay_removed:
        way = "earlier" if ensemble.delay_removed > 0 else "later"
        sentences.insert(
            0,
            f"The torque was taken {abs(1000 * ensemble.delay_removed):.3g} ms {way} than "
            "recorded.",
        )
    if ensemble.mean_subtracted:
        sentences.append("At each time, the mean over realizations was subtracted from both.")
    return sentences


def _perturbation(account: Account) -> list[str]:
    if account.diagnosis is None:
        return []
    rms, width = (
        account.diagnosis.measures[name][0] for name in ("angle RMS", "bandwidth of the angle")
    )
    return [
        f"What remained of the angle, the perturbation, had {rms:.3g} rad RMS and 95 % of its "
        f"power below {width:.3g} Hz."
    ]


def _chosen(account: Account) -> list[str]:
    if not (evidence := account.found.evidence):
        return []
    criteria = "; ".join(f"{label} by {item.criterion}" for label, item in evidence.items())
    return [f"Settings were chosen from the data ({criteria})."]


def _pathways(account: Account, label: str) -> list[str]:
    """State whether, and for which methods, the stiffness includes a reflex."""
    blamed = one_pathway(account.found)
    if label not in blamed:
        if not reflex_shown(account.found.models[label]):
            return [
                "The data show no stretch reflex, and this stiffness is that of a joint without "
                "one."
            ]
        share = negative_reflex(account.found.models[label])
        intrinsic = (
            "A stretch reflex was modelled beside this stiffness, but its gain was negative over "
            f"{share}, as no stretch reflex's is: the difference from methods with one pathway is "
            "an uncertainty of this estimate."
            if share
            else "This stiffness is the intrinsic one: a stretch reflex was estimated beside it."
        )
        what = "that torque" if share else "the reflex"
        return [intrinsic, *([f"That of {', '.join(blamed)} includes {what}."] if blamed else [])]
    return (
        ["This stiffness includes a stretch reflex, which the data show."]
        if reflex_found(account)
        else []
    )


def _faults(account: Account) -> list[str]:
    """Describe the findings of the diagnosis."""
    if account.diagnosis is None or not account.diagnosis.findings:
        return []
    titles = "; ".join(each.fault.title.lower() for each in account.diagnosis.findings)
    return [f"A diagnosis of the data found: {titles}."]


def _results(account: Account, label: str) -> list[str]:
    """Return what the leading method found."""
    found, model = account.found, account.found.models[label]
    known = model.stiffness[np.isfinite(model.stiffness)]
    if not known.size:
        return []
    lower, upper = found.bands[label]["stiffness"]
    band = mean_of(upper - lower) / 2
    sentences = [
        f"By {label}, stiffness was {known.mean():.1f} N·m/rad on average over time, from "
        f"{known.min():.1f} to {known.max():.1f}"
        + (
            f" (half width of the pointwise 95 % band {band:.1f} on average)."
            if np.isfinite(band)
            else "."
        )
    ]
    held_out, inside = account.held_out_mean(label), mean_of(found.vaf[label])
    if np.isfinite(held_out):
        count_of = min(FOLDS, len(found.ensemble))
        folds = f" ({count_of} folds of consecutive realizations)" if count_of > 1 else ""
        sentences.append(
            f"It accounted for {held_out:.1f} % of the variance of the torque in "
            f"{account.where_held_out} that it was not identified from{folds}, and for "
            f"{inside:.1f} % in what it was."
        )
    elif np.isfinite(inside):
        sentences.append(
            f"It accounted for {inside:.1f} % of the variance of the torque that it was identified "
            "from."
        )
    return sentences
