"""Result of an identification: values, sentences and tables, for the command line and pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from tvsysid.comparison import Comparison
from tvsysid.figures.words import unit_name
from tvsysid.methods.adaptive.model import AdaptiveModel, changes
from tvsysid.models import IMPEDANCE, OVER_TIME
from tvsysid.numerics.bands import mean_of
from tvsysid.quality import Diagnosis
from tvsysid.recommendation.trust import Trust, has_one_pathway
from tvsysid.report.page import filled
from tvsysid.signals import Array

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ["method", "quantity", "unit", "over", "mean", "half_band", "lowest", "lowest at (s)"]
COLUMNS += ["highest", "highest at (s)"]
DETAILS = {
    "delay": ("delay of the reflex", "s"),
    "frequency": ("frequency of the muscle", "rad/s"),
    "damping": ("damping of the muscle", ""),
    "threshold": ("threshold of the reflex", "rad/s"),
    "vaf_intrinsic": ("VAF, intrinsic", "%"),
    "vaf_reflex": ("VAF, reflex", "%"),
    "vaf_folds": ("VAF, five folds", "%"),
}
"""Names and units of what models with a reflex know beside their estimates."""


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

    @cached_property
    def values(self) -> dict[str, Any]:
        """Values that the sentences about an identification take."""
        found, label = self.found, self.found.leading
        model, table = found.models[label], found.over_variables()
        lower, upper = found.bands[label]["stiffness"]
        if len(table):
            own = (table.method == label) & (table.quantity == "scheduled_stiffness")
            table = table[own].iloc[[0, own.sum() // 2, -1]] if own.any() else table[own]
        means = ((mean_of(each.stiffness), name) for name, each in found.models.items())
        finite = sorted(each for each in means if np.isfinite(each[0]) and each[1] != label)
        faults = () if self.diagnosis is None else self.diagnosis.findings
        reflexes = [each for each in faults if each.name == "reflex"]
        one_pathway = [
            name
            for name, each in found.models.items()
            if has_one_pathway(found.methods[name], each)
        ]
        is_reflex = reflexes or "reflex_gain" in model.estimates
        return {
            "account": self,
            "found": found,
            "ensemble": found.ensemble,
            "diagnosis": self.diagnosis,
            "trust": self.trust,
            "label": label,
            "adaptive": isinstance(model, AdaptiveModel),
            "changes": changes(model) if isinstance(model, AdaptiveModel) else [],
            "stiffness": model.stiffness[np.isfinite(model.stiffness)],
            "axes": model.estimates["stiffness"].axes if "stiffness" in model.estimates else (),
            "band": mean_of(upper - lower) / 2,
            "over_variable": table,
            "others": finite,
            "held_out": self.held_out_mean(label),
            "in_sample": mean_of(found.vaf[label]),
            "one_pathway": one_pathway,
            "reflexes": reflexes,
            "with_reflex": [name for name in one_pathway if name != label] if is_reflex else [],
        }


def answer(account: Account) -> list[str]:
    """Return the lines that state the stiffness, or say why none is stated."""
    return [line for line in filled("answer.txt", **account.values).splitlines() if line]


def estimates(found: Comparison) -> pd.DataFrame:
    """Return all that the methods estimate: mean, half width of the 95 % band, and extremes.

    Times of the extremes are those of estimates over time. A reflex has its shape, with the share
    of the torque's variance that each pathway explains.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    rows = []
    for label, model in found.models.items():
        for name, estimate in model.estimates.items():
            values, (lower, upper) = estimate.values, estimate.limits()
            if is_over_time := estimate.axes in OVER_TIME:
                values, (lower, upper) = model.over_time(name), found.bands[label][name]
            if not np.isfinite(values).any():
                continue
            row = {
                "method": label,
                "quantity": name.replace("_", " "),
                "unit": unit_name(estimate.unit),
                "over": ", ".join(estimate.axes),
                "mean": mean_of(values),
                "half_band": mean_of(upper - lower) / 2,
                "lowest": float(np.nanmin(values)),
                "highest": float(np.nanmax(values)),
            }
            if is_over_time:
                row["lowest at (s)"] = model.time[np.nanargmin(values)]
                row["highest at (s)"] = model.time[np.nanargmax(values)]
            rows.append(row)
        details = model.diagnostics.details
        for name in filter(details.__contains__, DETAILS):
            half = 1.96 * details.get(f"{name}_error", float("nan"))
            row = {"method": label, "over": "", "mean": details[name], "half_band": half}
            rows.append(row | dict(zip(("quantity", "unit"), DETAILS[name], strict=True)))
    return pd.DataFrame(rows, columns=COLUMNS)


def further(found: Comparison) -> pd.DataFrame:
    """Return the estimates beside stiffness, viscosity and inertia over time."""
    table = estimates(found)
    return table[table["lowest at (s)"].isna() | ~table.quantity.isin(IMPEDANCE)]
