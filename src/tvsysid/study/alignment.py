"""What aligning realizations to a target does to their stiffness."""

from __future__ import annotations

import math
import warnings
from typing import NamedTuple

import numpy as np

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods import ShortDataSegments
from tvsysid.preprocess import Preparation, subtract_mean
from tvsysid.signals import Ensemble
from tvsysid.study.experiment import MAX_LAG_S, SHORT_WINDOW_S

GROUPS = 10  # of realizations, each of which is left out once


class AlignmentEffect(NamedTuple):
    """Mean stiffness of the same realizations in N·m/rad, and the standard error of the difference.

    ``aligned`` is that of the survivors, ``unshifted`` of the same ones as they were recorded.
    """

    aligned: float
    unshifted: float
    standard_error: float


UNKNOWN: AlignmentEffect = AlignmentEffect(math.nan, math.nan, math.nan)


def effect_of_alignment(preparation: Preparation) -> AlignmentEffect:
    r"""Identify the kept realizations with and without their shifts, by sds.

    The standard error is a jackknife over groups of realizations, of which each is left out of
    both:

    .. math:: \sqrt{\tfrac{G - 1}{G} \sum_g (d_g - \bar d)^2}

    All are NaN where nothing was aligned, or sds cannot serve the realizations.
    """
    if "alignment" not in preparation.steps:
        return UNKNOWN
    aligned = preparation.ensemble
    unshifted = subtract_mean(preparation.recorded.select(preparation.kept))
    count = min(GROUPS, len(aligned))
    group = np.arange(len(aligned)) % count
    everything = group >= 0
    with warnings.catch_warnings(action="ignore", category=DataQualityWarning):
        try:
            whole, *parts = (
                [_mean_stiffness(each.select(chosen)) for each in (aligned, unshifted)]
                for chosen in (everything, *(group != number for number in range(count)))
            )
        except InputError:
            return UNKNOWN
    error = math.sqrt((count - 1) * float(np.var(np.diff(parts))))
    return AlignmentEffect(whole[0], whole[1], error)


def _mean_stiffness(ensemble: Ensemble) -> float:
    found = ShortDataSegments(max_lag=MAX_LAG_S, window=SHORT_WINDOW_S).identify(ensemble).stiffness
    return float(np.nanmean(found)) if np.isfinite(found).any() else math.nan
