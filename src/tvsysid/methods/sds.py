"""Short data segments (SDS)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tvsysid.errors import InputError
from tvsysid.estimates import StandardError, no_errors
from tvsysid.methods.base import EXCITED_ABOVE, Method, check_positive, fitting_lags, whole_samples
from tvsysid.methods.shared.correlations import (
    Windows,
    coloured_variances,
    impulse_response_model,
    solve_windows,
    window_diagnostics,
    window_errors,
)
from tvsysid.methods.shared.residuals import counted, independent_realizations
from tvsysid.methods.tuning.evidence import Evidence
from tvsysid.methods.tuning.halves import evidence_by_halves
from tvsysid.models import ImpulseResponseModel
from tvsysid.numerics.pseudoinverse import truncated
from tvsysid.signals import Ensemble

LAGS = (0.03, 0.04, 0.06, 0.08, 0.12, 0.16)
"""Lags in s of which tuned ones are the best."""
WINDOWS = (0.02, 0.04, 0.06, 0.08, 0.10, 0.14, 0.20, 0.30, 0.40)
"""Windows in s of which a tuned one is the best."""


@dataclass(frozen=True)
class ShortDataSegments(Method):
    r"""A two-sided impulse response at each time, estimated across realizations and a short window of time.

    .. math:: \varphi_{yu}(t, k) = \frac1L \sum_r \sum_{i = t - N/2}^{t + N/2} u_r(i - k)\, y_r(i), \qquad
              L = (N + 1) R

    (equation 7 of van de Ruit et al. 2021; Ludvig & Perreault 2012), with the autocorrelations alike; solved as in
    :class:`EnsembleIRF`, the description length counting all L samples.

    Parameters
    ----------
    max_lag
        Lags to either side in s.
    window
        Time N Δt over which the joint is taken as constant, in s. An instantaneous change is spread over it: the rise
        from 10 to 90 % takes 80 % of it.

    Notes
    -----
    The window holds N + 1 samples, centred. It is cut short where a realization's context ends, and the number
    of samples actually averaged is counted. Stiffness is the area under the impulse response (equation 20); viscosity
    and inertia are those of a second-order fit to it, as in :class:`EnsembleIRF`.

    The bands count that the noise of neighbouring samples in a window is correlated, by the autocorrelation of the
    residual, which is taken to be the same at all times; the noise's strength may change. They do not count what the
    window smooths: about a switch, the truth lies outside. Windows that hold fewer than three samples for each lag, or
    only one realization, have none.
    """

    max_lag: float = 0.12
    window: float = 0.10

    key: ClassVar[str] = "sds"
    title: ClassVar[str] = "Short data segments"
    assumptions: ClassVar[tuple[str, ...]] = (
        "Behaviour is the same in all realizations.",
        "The joint is constant over a short window, which limits the fastest change that is seen.",
        "Nothing is assumed of the dynamics.",
    )

    def __post_init__(self) -> None:
        check_positive(self, max_lag=self.max_lag, window=self.window)

    def _identify(self, ensemble: Ensemble) -> ImpulseResponseModel:
        lags = fitting_lags("ShortDataSegments", self.max_lag, ensemble)
        half = whole_samples(self.window / 2, ensemble)
        if 2 * half + 1 > ensemble.samples:
            raise InputError(
                f"ShortDataSegments: a window of {self.window:g} s ({2 * half + 1} samples) is longer than a "
                f"realization of {ensemble.samples} samples; give a shorter one"
            )
        windows = solve_windows(ensemble, lags, half, lambda _, *correlations: truncated(*correlations))
        return impulse_response_model(
            repr(self),
            ensemble,
            windows.weights,
            windows.impedance,
            lags,
            window_diagnostics(ensemble, windows, lags, half),
            _errors(ensemble, lags, half, windows),
        )

    def _doubts(self, ensemble: Ensemble) -> Iterator[str]:
        unknowns = 2 * whole_samples(self.max_lag, ensemble) + 1
        samples = (2 * whole_samples(self.window / 2, ensemble) + 1) * len(ensemble)
        if samples < 4 * unknowns:
            yield (
                f"a window holds {samples} samples of all realizations for {unknowns} lags: the fit is hardly "
                "determined; record more, or lengthen window"
            )

    def _evidence(self, ensemble: Ensemble, seed: int) -> Evidence:
        return evidence_by_halves(self, ensemble, seed, {"max_lag": LAGS, "window": WINDOWS}, self.max_lag)

    def _needed_band(self, ensemble: Ensemble) -> tuple[float, float]:
        return 1 / (2 * self.max_lag), EXCITED_ABOVE


def _errors(ensemble: Ensemble, lags: int, half: int, windows: Windows) -> dict[str, StandardError]:
    """Standard errors at the times whose windows hold samples enough to tell it."""
    unknowns = 2 * lags + 1
    independent = independent_realizations(ensemble)
    samples = windows.samples * independent / len(ensemble)
    enough = (samples >= FEWEST * unknowns) & (independent >= FEWEST_REALIZATIONS)
    if not enough.any():
        why = (
            f"windows over {counted(ensemble)} hold {samples.max():.0f} independent samples for {unknowns} lags, where "
            f"{FEWEST} for each and {FEWEST_REALIZATIONS} realizations are needed to tell the noise from what the "
            "joint does; record more, shorten max_lag, or lengthen window"
        )
        return no_errors(ensemble.samples, why)
    variances = coloured_variances(ensemble, lags, half, windows)
    variances[~enough] = np.nan
    return window_errors(ensemble, lags, windows, variances)


FEWEST = 3
"""Samples for each lag below which a window has no band: with fewer, bands of 95 % held the truth in 78 to 90 %."""
FEWEST_REALIZATIONS = 2
"""Independent realizations below which there is none either: in one, the noise is hardly known (80 to 86 %)."""
