"""Sentences on how the alignment of realizations changes their stiffness, and what to do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tvsysid.report import page

if TYPE_CHECKING:
    import pandas as pd

# A change beyond this percentage and this number of standard errors needs action
NOTABLE, CERTAIN = 5.0, 2.0
REMEDY = (
    "The shift that fits the target best answers to the perturbation too, and takes a part of its "
    "response away. With reference = false under [preparation] in the study file (reference=None "
    "in Python) nothing is shifted, nor excluded for its shift; compare with that. kbr takes the "
    "time of the target, which the shift does not touch."
)


def notable(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of :func:`tvsysid.study.alignments` that need action."""
    certain = table.difference.abs() > CERTAIN * table.standard_error
    return table[certain & (table.percent.abs() > NOTABLE)]


def sentence(table: pd.DataFrame) -> str:
    """Describe the effect of the alignment on the stiffness of one or more recordings.

    Empty if none was aligned.
    """
    if not len(table):
        return ""
    aligned, unshifted = table.aligned.mean(), table.unshifted.mean()
    error = float(np.sqrt(np.sum(table.standard_error**2))) / len(table)
    several = f" in the mean of {len(table)} recordings" if len(table) > 1 else ""
    text = (
        f"Aligning realizations to the target changes the stiffness by {aligned - unshifted:.1f} ± "
        f"{error:.1f} N·m/rad ({100 * (aligned / unshifted - 1):.0f} %){several}: {aligned:.1f} "
        f"instead of {unshifted:.1f}, by sds from all that were kept."
    )
    return text.replace("-", "−")


def alignment_table(table: pd.DataFrame) -> page.Table:
    """Return a table of the effect of the alignment on each recording."""
    caption = (
        "Mean stiffness over time of the realizations that were kept, identified by sds with the "
        "shifts that align them to the target and as they were recorded; after ± stands one "
        f"standard error. {REMEDY}"
    )
    unit = "N·m/rad"
    columns = [
        page.Column("recording", kind="label"),
        *(
            page.Column(heading, unit, "number")
            for heading in ("aligned", "unshifted", "difference")
        ),
        page.Column("difference", "%", "number"),
    ]
    rows = [
        page.Row(
            [
                each["recording"],
                page.number(each["aligned"], decimals=1),
                page.number(each["unshifted"], decimals=1),
                page.number(each["difference"], each["standard_error"], 1),
                page.number(each["percent"], decimals=0),
            ]
        )
        for each in table.to_dict("records")
    ]
    return page.Table(
        "What the alignment does to the stiffness", caption, columns, rows, narrow=True
    )
