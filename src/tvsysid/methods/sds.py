"""Short data segments (SDS)."""

from __future__ import annotations

from collections.abc import Iterator

import attrs

from tvsysid.errors import InputError
from tvsysid.methods import shared
from tvsysid.methods.base import fitting_lags, whole_samples
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.models import Model
from tvsysid.signals import Ensemble
from tvsysid.validators import not_negative, positive

# Independent samples for a band. With fewer, a band of 95 % held the truth in only 78 to 90 %.
MIN_SAMPLES_PER_LAG = 3


@attrs.frozen
class ShortDataSegments(shared.ReferenceMethod):
    r"""Estimate a two-sided impulse response at each time, across realizations and a short window.

    .. math:: \varphi_{yu}(t, k) = \frac1L \sum_r \sum_{i = t - N/2}^{t + N/2}
              u_r(i - k)\, y_r(i), \qquad L = (N + 1) R

    (equation 7 of van de Ruit et al. 2021; Ludvig & Perreault 2012). Autocorrelations are computed
    in the same way. The equations are solved as in :class:`EnsembleIRF`, with a description length
    that counts all L samples.

    Parameters
    ----------
    max_lag
        Largest lag on either side, in s.
    window
        Time N Δt over which the joint is assumed constant, in s. An instantaneous change is spread
        over the window: the rise from 10 to 90 % takes 80 % of it. 0 fits each time
        separately.
    reference
        Channel that moves the joint from outside, for a joint in closed loop. The angle that is
        predicted from it is the instrument (:mod:`tvsysid.methods.shared.instrument`).

    Notes
    -----
    The window holds N + 1 samples, centred. It is cut short where a realization's context ends,
    and the number of samples actually averaged is counted. Stiffness is the area under the impulse
    response (equation 20). Viscosity and inertia are those of a second-order fit to it, as in
    :class:`EnsembleIRF`.

    The bands account for correlated noise, by the autocorrelation of the residual. This
    autocorrelation is assumed to be the same at all times; the strength of the noise may change.
    The bands do not cover the smoothing bias of the window: near a switch, the truth lies outside.
    There is no band with fewer than three independent samples for each lag.
    """

    max_lag: float = attrs.field(default=0.12, validator=positive)
    window: float = attrs.field(default=0.10, validator=not_negative)
    reference: str | None = None

    key = "sds"
    title = "Short data segments"
    assumptions = (
        "The movement is the same in all realizations.",
        "The joint is constant over a short window, which limits the fastest change that is seen.",
        "Nothing is assumed of the dynamics.",
    )
    differs = (
        "It is a mean over its window: faster changes are smoothed, and a switch becomes a ramp as "
        "long as the window."
    )
    cites = ("ludvig2012", "vanderuit2021")

    def _fit(self, ensemble: Ensemble, instrument: Ensemble) -> ImpulseResponseModel:
        lags = fitting_lags("ShortDataSegments", self.max_lag, ensemble)
        half = whole_samples(self.window / 2, ensemble)
        if 2 * half + 1 > ensemble.samples:
            raise InputError(
                f"ShortDataSegments: a window of {self.window:g} s ({2 * half + 1} samples) is "
                f"longer than a realization of {ensemble.samples} samples; give a shorter one"
            )
        windows = shared.solve_windows(instrument, lags, half)
        needed = MIN_SAMPLES_PER_LAG * (2 * lags + 1)
        return shared.window_model(ensemble, instrument, windows, half, needed)

    def _own_warnings(self, ensemble: Ensemble, model: Model) -> Iterator[str]:
        unknowns = 2 * whole_samples(self.max_lag, ensemble) + 1
        samples = (2 * whole_samples(self.window / 2, ensemble) + 1) * len(ensemble)
        if samples < 4 * unknowns:
            yield (
                f"a window holds {samples} samples of all realizations for {unknowns} lags: the "
                "fit is hardly determined; record more, or lengthen window"
            )
