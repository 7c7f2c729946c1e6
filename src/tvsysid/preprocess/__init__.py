"""From a recording to an ensemble: decimate, trim, segment, align, exclude, subtract the mean; bootstrap it."""

from tvsysid.preprocess.account import Account, Step
from tvsysid.preprocess.align import align
from tvsysid.preprocess.bootstrap import block_weights, bootstrap, bootstrap_weights
from tvsysid.preprocess.decimate import decimate
from tvsysid.preprocess.exclude import exclude_residual_outliers, exclude_task_outliers
from tvsysid.preprocess.prepare import Preparation, prepare
from tvsysid.preprocess.segment import segment, subtract_mean
from tvsysid.preprocess.trim import trim

__all__ = [
    "Account",
    "Preparation",
    "Step",
    "align",
    "block_weights",
    "bootstrap",
    "bootstrap_weights",
    "decimate",
    "exclude_residual_outliers",
    "exclude_task_outliers",
    "prepare",
    "segment",
    "subtract_mean",
    "trim",
]
