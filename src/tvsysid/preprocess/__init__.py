"""Turn a recording into an ensemble: decimate, trim, segment, align, exclude, subtract the mean.

Each step raises an :class:`tvsysid.InputError` for settings or data that do not allow it.
"""

from tvsysid.preprocess.bootstrap import bootstrap_weights
from tvsysid.preprocess.faults import find_gaps, find_mains, remove_mains
from tvsysid.preprocess.mean import subtract_mean
from tvsysid.preprocess.prepare import (
    Preparation,
    Step,
    align,
    exclude_residual_outliers,
    exclude_task_outliers,
    prepare_experiment,
)
from tvsysid.preprocess.trials import Gap, align_channels, decimate, excerpt, segment, trim

__all__ = [
    "Gap",
    "Preparation",
    "Step",
    "align",
    "align_channels",
    "bootstrap_weights",
    "decimate",
    "excerpt",
    "exclude_residual_outliers",
    "exclude_task_outliers",
    "find_gaps",
    "find_mains",
    "prepare_experiment",
    "remove_mains",
    "segment",
    "subtract_mean",
    "trim",
]
