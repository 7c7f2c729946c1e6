"""From a recording to an ensemble: decimate, trim, segment, align, exclude, subtract the mean.

Bootstrap it.

Each step raises an :class:`tvsysid.InputError` for settings or data that do not allow it.
"""

from tvsysid.preprocess.account import Account, Step
from tvsysid.preprocess.bootstrap import block_weights, bootstrap, bootstrap_weights
from tvsysid.preprocess.exclude import align, exclude_residual_outliers, exclude_task_outliers
from tvsysid.preprocess.gaps import Gap, find_gaps
from tvsysid.preprocess.mains import find_mains, remove_mains
from tvsysid.preprocess.preparation import Preparation, prepare
from tvsysid.preprocess.segment import align_channels, decimate, segment, subtract_mean, trim

__all__ = [
    "Account",
    "Gap",
    "Preparation",
    "Step",
    "align",
    "align_channels",
    "block_weights",
    "bootstrap",
]
__all__ += [
    "bootstrap_weights",
    "decimate",
    "exclude_residual_outliers",
    "exclude_task_outliers",
    "find_gaps",
]
__all__ += ["find_mains", "prepare", "remove_mains", "segment", "subtract_mean", "trim"]
