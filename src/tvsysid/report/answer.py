"""Result of an identification in sentences and rows, for the command line and pages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import attrs
import numpy as np

from tvsysid.comparison import Comparison
from tvsysid.figures.words import unit_name
from tvsysid.methods.adaptive.model import AdaptiveModel, Switch, changes
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_of
from tvsysid.quality import Diagnosis
from tvsysid.recommendation.trust import Trust, has_one_pathway
from tvsysid.signals import Array

IMPEDANCE_UNITS = {"stiffness": "N·m/rad", "viscosity": "N·m·s/rad", "inertia": "kg·m²"}
# Units of the reflex parameters
REFLEX = {"delay": "s", "frequency": "rad/s", "damping": "", "threshold": "rad/s"}
EXPLAINED = {
    "vaf": "torque explained",
    "vaf_intrinsic": "by the intrinsic pathway",
    "vaf_reflex": "by the reflex",
}
EXPLAINED |= {"vaf_held_out": "of realizations held out", "vaf_folds": "of five folds held out"}


@attrs.frozen(eq=False)
class Account:
    """All that is known of an identification.

    What was ``found``; the ``held_out`` VAF of :meth:`tvsysid.Comparison.held_out_vaf`, if it
    was computed; the ``diagnosis`` of the same ensemble, or why there is none (``undiagnosed``);
    the ``source`` of the data, as rows of a table (``{"file": "ankle.mat", "angle": "channel
    pos"}``); what was ``turned`` when the file was read, for the methods paragraph (``["the
    torque's sign was reversed"]``); ``unnamed_references``, a sentence for each channel of the
    file that moves the angle and was not read.
    """

    found: Comparison
    held_out: Mapping[str, Array] = attrs.field(factory=dict)
    diagnosis: Diagnosis | None = None
    undiagnosed: str = "nobody looked"
    source: Mapping[str, str] = attrs.field(factory=dict)
    turned: Sequence[str] = ()
    unnamed_references: Sequence[str] = ()

    @cached_property
    def trust(self) -> Trust:
        """How far the stiffness can be trusted, and why not further."""
        return self.found.trust(self.diagnosis, self.held_out, self.unnamed_references)

    def held_out_mean(self, label: str) -> float:
        """Return the mean held-out VAF of a method in per cent.

        NaN if not known.
        """
        values = self.held_out.get(label, np.array([]))
        if np.isfinite(values).any() or label not in self.found.models:
            return mean_of(values)
        return self.found.models[label].diagnostics.details.get("vaf_folds", float("nan"))

    @property
    def where_held_out(self) -> str:
        """Of what the held-out VAF is."""
        return "realizations" if len(self.found.ensemble) > 1 else "fifths of the record"


class Further(NamedTuple):
    """Estimate beside impedance over time: its mean, the half width of its band, its extremes."""

    method: str
    quantity: str
    unit: str
    over: str
    mean: float
    half_band: float
    lowest: float
    highest: float


def answer(account: Account) -> list[str]:
    """Return the lines that state the stiffness, or say why none is stated."""
    found, trust = account.found, account.trust
    if trust.level == "none":
        first, *more = trust.reasons
        return [f"no stiffness is stated. {first}", *more]
    label, model = found.leading, found.models[found.leading]
    role = trust.level if trust.level == "doubtful" else "recommended" if found.recommended else ""
    stated = f"{role} ({label})" if role else label
    lines = _over_variable(found, label, stated)
    known = model.stiffness[np.isfinite(model.stiffness)]
    if not known.size:
        return lines or [f"{label} estimates no stiffness over time"]
    lower, upper = found.bands[label]["stiffness"]
    band = mean_of(upper - lower) / 2
    single = len(found.ensemble) > 1 and "realization" in model.estimates["stiffness"].axes
    without = (
        "a mean over realizations, of which each has a band of its own"
        if single
        else "without a band"
    )
    lines.append(
        f"{'over time:' if lines else f'{stated}: stiffness'} {known.min():.1f} to "
        f"{known.max():.1f} N·m/rad, {known.mean():.1f} on average, "
        f"{f'95 % band ± {band:.1f}' if np.isfinite(band) else without}"
    )
    return [*lines, *trust.reasons, *(changes(model) if isinstance(model, AdaptiveModel) else [])]


def _over_variable(found: Comparison, label: str, stated: str) -> list[str]:
    """Describe stiffness over a variable: at both ends and in the middle.

    Empty if there is none.
    """
    table = found.over_variables()
    if table.empty:
        return []
    if (own := table[(table.method == label) & (table.quantity == "scheduled_stiffness")]).empty:
        return []
    at = own.iloc[[0, len(own) // 2, -1]]
    rows = at[["value", "estimate", "lower", "upper"]].to_numpy(dtype=float)
    values = [
        f"{each:.1f} ± {(upper - lower) / 2:.1f} at {value:.3g}"
        for value, each, lower, upper in rows
    ]
    return [
        f"{stated}: stiffness over {own.variable.iloc[0]}: {', '.join(values)} (N·m/rad, ± 95 % "
        "band)"
    ]


def switches(model: Model, quantity: str = "stiffness") -> list[Switch]:
    """Return the switches that a method found; none if it does not look for them."""
    found = getattr(model, "switches", ())
    return [each for each in found if each.quantity == quantity]


def others(found: Comparison) -> str:
    """Describe the mean stiffness by the other methods; empty if there are none."""
    means = {
        label: mean_of(model.stiffness)
        for label, model in found.models.items()
        if label != found.leading
    }
    known = sorted((value, label) for label, value in means.items() if np.isfinite(value))
    if not known:
        return ""
    (low, first), (high, last) = known[0], known[-1]
    return (
        f"{low:.1f} N·m/rad ({first})"
        if len(known) == 1
        else f"{low:.1f} ({first}) to {high:.1f} N·m/rad ({last})"
    )


def why_leading(account: Account) -> str:
    """Return why this method leads; nothing of a recommended one whose stiffness is doubtful."""
    found, label = account.found, account.found.leading
    if found.recommended:
        if account.trust.level == "doubtful":
            return ""
        if isinstance(found.models[label], AdaptiveModel):
            why = (
                "it has no settings that could be chosen wrongly, and its band counts how unsure "
                "it is of how fast stiffness changes, and of when it switches"
            )
        else:
            why = found.recommendation.why
        return f"{label} is recommended: {why}."
    missing = {"skipped": found.skipped, "failed": found.failed}
    reasons = [
        f"adaptive is {how}: {each['adaptive']}. "
        for how, each in missing.items()
        if "adaptive" in each
    ]
    if len(found.models) == 1:
        return f"{''.join(reasons)}{label} is the only method that was used."
    return (
        f"{''.join(reasons)}{label} comes first among the methods that were asked for; the data "
        "did not choose it."
    )


def taken(seconds: float) -> str:
    """Describe the correction of a delay of the torque."""
    return (
        f"the torque is taken {abs(1000 * seconds):.3g} ms {'earlier' if seconds > 0 else 'later'}"
    )


def further(found: Comparison) -> Iterator[Further]:
    """Yield the estimates beside stiffness, viscosity and inertia over time."""
    for label, model in found.models.items():
        for name, estimate in model.estimates.items():
            if name in IMPEDANCE_UNITS and set(estimate.axes) <= {"realization", "time"}:
                continue
            lower, upper = estimate.limits()
            half = mean_of(upper - lower) / 2
            known = estimate.values[np.isfinite(estimate.values)]
            if known.size:
                words = (name.replace("_", " "), unit_name(estimate.unit), ", ".join(estimate.axes))
                yield Further(label, *words, known.mean(), half, known.min(), known.max())


def reflex_shape(details: Mapping[str, float]) -> str:
    """Describe the reflex: delay, muscle, threshold, and the share of torque of each pathway."""
    found = []
    for name, unit in REFLEX.items():
        if name in details:
            error = details.get(f"{name}_error")
            spread = "" if error is None else f" ± {1.96 * error:.2g}"
            found.append(f"{name} {details[name]:.3g}{spread} {unit}".rstrip())
    shares = [
        f"{words} {details[name]:.1f} %" for name, words in EXPLAINED.items() if name in details
    ]
    return "; ".join(part for part in (", ".join(found), ", ".join(shares)) if part)


def one_pathway(found: Comparison) -> list[str]:
    """Return the labels of the methods that include a reflex in the stiffness."""
    return [
        label
        for label, model in found.models.items()
        if has_one_pathway(found.methods[label], model)
    ]


def with_reflex(account: Account) -> list[str]:
    """Return the labels of other methods whose stiffness includes a reflex that was found."""
    found = account.found
    is_reflex = reflex_found(account) or "reflex_gain" in found.models[found.leading].estimates
    return [label for label in one_pathway(found) if label != found.leading] if is_reflex else []


def reflex_found(account: Account) -> str:
    """Return the finding of a reflex in words; empty if there is none."""
    checks = () if account.diagnosis is None else account.diagnosis.findings
    return next(
        (f"{each.what}; {each.fault.remedy}" for each in checks if each.name == "reflex"), ""
    )
