"""How the alignment of realizations changes their stiffness, and what to do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

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


def notable(aligned: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of :func:`tvsysid.study.alignments` that need action."""
    certain = aligned.difference.abs() > CERTAIN * aligned.standard_error
    return aligned[certain & (aligned.percent.abs() > NOTABLE)]


def sentence(aligned: pd.DataFrame) -> str:
    """Describe the effect of the alignment on the stiffness of one or more recordings.

    Empty if none was aligned.
    """
    if not len(aligned):
        return ""
    after, before = aligned.aligned.mean(), aligned.unshifted.mean()
    error = float(np.sqrt(np.sum(aligned.standard_error**2))) / len(aligned)
    several = f" in the mean of {len(aligned)} recordings" if len(aligned) > 1 else ""
    text = (
        f"Aligning realizations to the target changes the stiffness by {after - before:.1f} ± "
        f"{error:.1f} N·m/rad ({100 * (after / before - 1):.0f} %){several}: {after:.1f} "
        f"instead of {before:.1f}, by sds from all that were kept."
    )
    return text.replace("-", "−")
