"""Metrics of an identification, one function each."""

from tvsysid.metrics.errors import (
    Value,
    bias_error,
    coverage,
    debiased_bias_error,
    mean_bias,
    random_error,
    rise_time,
    share_covered,
    total_error,
    weighted_mean,
)
from tvsysid.metrics.variance import bandpassed_vaf, time_varying_vaf, vaf
