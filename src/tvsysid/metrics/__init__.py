"""Metrics of an identification, one function each, and their catalogue."""

from collections.abc import Callable

import attrs

from tvsysid.metrics.errors import (
    Value,
    bias_error,
    coverage,
    debiased_bias_error,
    left_out,
    mean_bias,
    random_error,
    rise_time,
    share_covered,
    total_error,
    weighted_mean,
)
from tvsysid.metrics.variance import bandpassed_vaf, time_varying_vaf, vaf


@attrs.frozen
class Metric:
    """Row of the catalogue.

    ``best`` is the value of a perfect identification, or of a perfect band of 95 %. Metrics that
    need the truth (``needs_truth``) are for simulated data only.
    """

    title: str
    unit: str
    best: float
    needs_truth: bool
    function: Callable[..., Value]


CATALOGUE: dict[str, Metric] = {
    "bias_error": Metric("bias error", "N·m/rad", 0.0, True, bias_error),
    "debiased_bias_error": Metric(
        "bias error freed of random error", "N·m/rad", 0.0, True, debiased_bias_error
    ),
    "mean_bias": Metric("mean bias", "N·m/rad", 0.0, True, mean_bias),
    "random_error": Metric("random error", "N·m/rad", 0.0, False, random_error),
    "total_error": Metric("total error", "N·m/rad", 0.0, True, total_error),
    "rise_time": Metric("rise time", "s", 0.0, True, rise_time),
    "vaf": Metric("variance accounted for", "%", 100.0, False, vaf),
    "bandpassed_vaf": Metric("variance accounted for, 1-10 Hz", "%", 100.0, False, bandpassed_vaf),
    "coverage": Metric("coverage of the 95 % band", "%", 95.0, True, coverage),
    "time_varying_vaf": Metric(
        "variance accounted for over time", "%", 100.0, False, time_varying_vaf
    ),
}
