"""From a recording to an ensemble: decimate, trim, segment, align, exclude, subtract the mean; bootstrap it.

Each step raises an :class:`tvsysid.InputError` for settings or data that do not allow it.
"""

from tvsysid.preprocess.account import Account, Step
from tvsysid.preprocess.bootstrap import block_weights, bootstrap, bootstrap_weights
from tvsysid.preprocess.exclude import align, exclude_residual_outliers, exclude_task_outliers
from tvsysid.preprocess.preparation import Preparation, prepare
from tvsysid.preprocess.segment import align_channels, decimate, segment, subtract_mean, trim

__all__ = ["Account", "Preparation", "Step", "align", "align_channels", "block_weights", "bootstrap"]
__all__ += ["bootstrap_weights", "decimate", "exclude_residual_outliers", "exclude_task_outliers", "prepare", "segment"]
__all__ += ["subtract_mean", "trim"]
