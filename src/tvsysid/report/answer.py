"""What an identification found, in sentences and rows: what the command line prints, and pages show."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tvsysid.comparison import Comparison
from tvsysid.errors import DataQualityWarning
from tvsysid.figures.words import unit_name
from tvsysid.methods.adaptive.model import AdaptiveModel, Switch
from tvsysid.methods.adaptive.words import changes
from tvsysid.methods.cascade.result import negative_share
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_of
from tvsysid.quality import Diagnosis, Finding
from tvsysid.signals import Array

IMPEDANCE_UNITS = {"stiffness": "N·m/rad", "viscosity": "N·m·s/rad", "inertia": "kg·m²"}
REFLEX = {"delay": "s", "frequency": "rad/s", "damping": "", "threshold": "rad/s"}  # units of what shapes a reflex
EXPLAINED = {"vaf": "torque explained", "vaf_intrinsic": "by the intrinsic pathway", "vaf_reflex": "by the reflex"}
EXPLAINED |= {"vaf_held_out": "of realizations held out", "vaf_folds": "of five folds held out"}


@dataclass(frozen=True, eq=False)
class Account:
    """All that is known of an identification.

    What was ``found``; the ``held_out`` VAF of :meth:`tvsysid.Comparison.held_out_vaf`, if it was computed; the
    ``diagnosis`` of the same ensemble, or why there is none (``undiagnosed``); the ``source`` of the data, as rows of a
    table (``{"file": "ankle.mat", "angle": "channel pos"}``); what was ``turned`` when the file was read, for the
    methods paragraph (``["the torque's sign was reversed"]``).
    """

    found: Comparison
    held_out: Mapping[str, Array] = field(default_factory=dict)
    diagnosis: Diagnosis | None = None
    undiagnosed: str = "nobody looked"
    source: Mapping[str, str] = field(default_factory=dict)
    turned: Sequence[str] = ()

    def held_out_mean(self, label: str) -> float:
        """Held-out VAF of a method in per cent, mean over realizations or by the method itself; NaN if not known."""
        values = self.held_out.get(label, np.array([]))
        if np.isfinite(values).any() or label not in self.found.models:
            return mean_of(values)
        return self.found.models[label].diagnostics.details.get("vaf_folds", float("nan"))

    @property
    def where_held_out(self) -> str:
        """Of what the held-out VAF is."""
        return "realizations" if len(self.found.ensemble) > 1 else "fifths of the record"


class Further(NamedTuple):
    """An estimate beside impedance over time: of which method, what, its unit, over which axes, and its values."""

    method: str
    quantity: str
    unit: str
    over: str
    values: Array
    half_band: float


def answer(found: Comparison, diagnosis: Diagnosis | None = None) -> list[str]:
    """Stiffness by the method to go by: over a variable, over time; an impossible sign, what is doubtful; changes."""
    label = found.leading
    model = found.models[label]
    lines = _over_variable(found, label)
    known = model.stiffness[np.isfinite(model.stiffness)]
    if not known.size:
        return lines or [f"{label} estimates no stiffness over time"]
    lower, upper = found.bands[label]["stiffness"]
    band = mean_of(upper - lower) / 2
    wrong = why_wrong(found, diagnosis)
    unsure = why_unsure(found, diagnosis)
    role = ", the one to go by" if isinstance(model, AdaptiveModel) and not unsure else ""
    single = len(found.ensemble) > 1 and "realization" in model.estimates["stiffness"].axes
    without = "a mean over realizations, of which each has a band of its own" if single else "without a band"
    lines.append(
        f"{'over time' if lines else f'stiffness by {label}{role}'}: {known.min():.1f} to {known.max():.1f} N·m/rad, "
        f"{known.mean():.1f} on average, {f'95 % band ± {band:.1f}' if np.isfinite(band) else without}"
    )
    return [*lines, *unsure, *(changes(model) if isinstance(model, AdaptiveModel) and not wrong else [])]


def wrong_period(diagnosis: Diagnosis | None) -> list[Finding]:
    """Finding that the behaviour has another period, if there is one."""
    return [each for each in (() if diagnosis is None else diagnosis.findings) if each.name == "wrong-period"]


def why_wrong(found: Comparison, diagnosis: Diagnosis | None) -> list[str]:
    """Why no method's stiffness can be right: it is negative, or the period is wrong."""
    if mean_of(found.models[found.leading].stiffness) < 0:
        return [
            "no joint has a negative stiffness: the torque's sign is probably reversed; read it with --torque-sign -1 "
            "(in Python torque_sign=-1), or without that; if the actuator gives way, record its command"
        ]
    return [
        f"the behaviour does not repeat every {found.ensemble.duration:g} s ({each.name}: {each.what}), so that its "
        f"time variation averages out whatever the method; {each.fault.remedy}"
        for each in wrong_period(diagnosis)
    ]


def why_unsure(found: Comparison, diagnosis: Diagnosis | None) -> list[str]:
    """Why not to trust the stiffness by the method to go by: it is wrong, or the reflex beside it is no reflex."""
    if wrong := why_wrong(found, diagnosis):
        return wrong
    if share := doubtful_reflex(found):
        return [
            f"the reflex gain is negative over {share}; no stretch reflex's is: take the difference from the stiffness "
            "of a method with one pathway (as kbr) for the uncertainty of this one"
        ]
    return []


def reflex_shown(found: Comparison) -> bool:
    """Whether the data show the reflex that the method to go by has beside its stiffness."""
    return bool(found.models[found.leading].diagnostics.details.get("reflex_shown", True))


def doubtful_reflex(found: Comparison) -> str:
    """Over how much of the time the reflex gain beside the stiffness is one of no reflex; empty if that is not seen."""
    gain = found.models[found.leading].estimates.get("reflex_gain")
    share = negative_share(gain) if gain is not None and reflex_shown(found) else 0.0
    return f"{100 * share:.0f} % of the time, with its whole 95 % band" if share else ""


def _over_variable(found: Comparison, label: str) -> list[str]:
    """Stiffness at both ends and in the middle of a variable that it was estimated over; empty if there is none."""
    if not found.rows_over_variables():
        return []
    table = found.over_variables()
    if (own := table[(table.method == label) & (table.quantity == "scheduled_stiffness")]).empty:
        return []
    at = own.iloc[[0, len(own) // 2, -1]]
    rows = at[["value", "estimate", "lower", "upper"]].to_numpy(dtype=float)
    values = [f"{each:.1f} ± {(upper - lower) / 2:.1f} at {value:.3g}" for value, each, lower, upper in rows]
    return [f"stiffness by {label} over {own.variable.iloc[0]}: {', '.join(values)} (N·m/rad, ± 95 % band)"]


def switches(model: Model, quantity: str = "stiffness") -> list[Switch]:
    """Sudden changes that were found; none by a method that does not look for them."""
    found = getattr(model, "switches", ())
    return [each for each in found if each.quantity == quantity]


def others(found: Comparison) -> str:
    """What the other methods give for the mean stiffness; empty where there are none."""
    means = {label: mean_of(model.stiffness) for label, model in found.models.items() if label != found.leading}
    known = sorted((value, label) for label, value in means.items() if np.isfinite(value))
    if not known:
        return ""
    (low, first), (high, last) = known[0], known[-1]
    return f"{low:.1f} N·m/rad ({first})" if len(known) == 1 else f"{low:.1f} ({first}) to {high:.1f} N·m/rad ({last})"


def why_leading(found: Comparison, sure: bool) -> str:
    """Why it is this method whose stiffness to report; nothing if it would be the one to go by, but is not ``sure``."""
    label = found.leading
    if isinstance(found.models[label], AdaptiveModel):
        why = (
            "it has no settings that could be chosen wrongly, and its band counts how unsure it is of how fast "
            "stiffness changes, and of when it switches"
        )
        return f"{label} is the method to go by: {why}." if sure else ""
    if len(found.models) > 1 and found.recommendation.leading({label: found.methods[label]}, found.evidence):
        return f"{label} is the method to go by: {found.recommendation.why}." if sure else ""
    missing = {"skipped": found.skipped, "failed": found.failed}
    reasons = [f"adaptive is {how}: {each['adaptive']}. " for how, each in missing.items() if "adaptive" in each]
    if len(found.models) == 1:
        return f"{''.join(reasons)}{label} is the only method that was used."
    return f"{''.join(reasons)}{label} comes first among the methods that were asked for; the data did not choose it."


def taken(seconds: float) -> str:
    """What is done about a delay of the torque, in words."""
    return f"the torque is taken {abs(1000 * seconds):.3g} ms {'earlier' if seconds > 0 else 'later'}"


def further(found: Comparison) -> Iterator[Further]:
    """What the methods estimate beside stiffness, viscosity and inertia over time."""
    for label, model in found.models.items():
        for name, estimate in model.estimates.items():
            if name in IMPEDANCE_UNITS and set(estimate.axes) <= {"realization", "time"}:
                continue
            half, error = float("nan"), estimate.standard_error
            if error is not None and np.isfinite(error.values).any():
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", DataQualityWarning)  # that there is none
                    lower, upper = estimate.band()
                half = float(np.nanmean(upper - lower)) / 2
            known = estimate.values[np.isfinite(estimate.values)]
            over = ", ".join(estimate.axes)
            yield Further(label, name.replace("_", " "), unit_name(estimate.unit), over, known, half)


def reflex_shape(details: Mapping[str, float]) -> str:
    """Delay, muscle and threshold of a reflex, and how much of the torque each pathway explains."""
    found = []
    for name, unit in REFLEX.items():
        if name in details:
            error = details.get(f"{name}_error")
            spread = "" if error is None else f" ± {1.96 * error:.2g}"
            found.append(f"{name} {details[name]:.3g}{spread} {unit}".rstrip())
    shares = [f"{words} {details[name]:.1f} %" for name, words in EXPLAINED.items() if name in details]
    return "; ".join(part for part in (", ".join(found), ", ".join(shares)) if part)


def one_pathway(found: Comparison) -> list[str]:
    """Labels of the methods that take a reflex for stiffness."""
    return [
        label
        for label, model in found.models.items()
        if "reflex" not in getattr(found.methods[label], "pathway_names", ()) and "reflex_gain" not in model.estimates
    ]


def reflex_found(account: Account) -> str:
    """What the diagnosis says of a reflex; empty if it found none."""
    checks = () if account.diagnosis is None else account.diagnosis.findings
    return next((f"{each.what}; {each.fault.remedy}" for each in checks if each.name == "reflex"), "")
