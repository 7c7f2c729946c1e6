"""How good an identification is: one function a metric, and their catalogue."""

from tvsysid.metrics.bands import coverage, share_covered
from tvsysid.metrics.catalogue import CATALOGUE, Metric
from tvsysid.metrics.errors import (
    bias_error,
    debiased_bias_error,
    left_out,
    random_error,
    rise_time,
    total_error,
    weighted_mean,
)
from tvsysid.metrics.variance import bandpassed_vaf, time_varying_vaf, vaf

__all__ = [
    "CATALOGUE",
    "Metric",
    "bandpassed_vaf",
    "bias_error",
    "coverage",
    "debiased_bias_error",
    "left_out",
    "random_error",
    "rise_time",
    "share_covered",
    "time_varying_vaf",
    "total_error",
    "vaf",
    "weighted_mean",
]
