"""Ensemble cascade (TV-PC): both pathways of a joint with any change, across realizations."""

from __future__ import annotations

import attrs
import numpy as np

from tvsysid.methods import base
from tvsysid.methods.cascade import alternating
from tvsysid.methods.eirf import EnsembleIRF
from tvsysid.methods.sds import ShortDataSegments
from tvsysid.numerics.moments import sliding_sum
from tvsysid.numerics.pseudoinverse import truncated
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import not_negative, positive


@attrs.frozen
class EnsembleCascade(alternating.AlternatingCascade):
    r"""Identify intrinsic and reflex response at each time in turn, across realizations.

    .. math:: y(t) = \Delta t \sum_{\tau=-n}^{n} h(t, \tau)\, \theta(t - \tau)
              + \Delta t \sum_{\tau=d}^{m} p(t, \tau)\, f(t - \tau)

    The intrinsic pathway is identified by :class:`ShortDataSegments` (:class:`EnsembleIRF` without
    a window) from the torque less the reflex's, the reflex by the same truncated pseudo-inverse
    from the torque less the intrinsic one, and so on until the torque explained grows by less than
    0.001 points. f is the velocity of stretch, rectified.

    Parameters
    ----------
    max_lag
        Lags of the intrinsic response to either side in s, no more than the reflex's delay.
        The reflex's response begins there.
    memory
        Last lag of the reflex's response in s.
    window
        Time in s over which the joint is taken as constant, as in :class:`ShortDataSegments`. 0, as
        the paper has it, takes each time by itself, and needs 500 to 800 realizations.

    Notes
    -----
    The direction of stretch and ``reflex_gain`` are those of :class:`BasisCascade`. The paper has a
    different static function at each time, with more coefficients than the usual number of
    realizations determines.

    Realizations that do not have the memory recorded before them are left out. No bands are stated.

    References
    ----------
    Ludvig, Starret Visser, Giesbrecht & Kearney 2011, IEEE Trans. Biomed. Eng. 58, 1715-1723.
    """

    max_lag: float = attrs.field(default=0.04, validator=positive)
    memory: float = attrs.field(default=0.5, validator=positive)
    window: float = attrs.field(default=0.10, validator=not_negative)

    key = "tvpc"
    title = "Ensemble parallel cascade"
    assumptions = (
        "Behaviour is the same in all realizations.",
        "The joint is constant over a short window; nothing else is assumed of how it changes.",
        "The intrinsic response ends before the reflex's delay does.",
        "Many realizations are needed: without a window, 500 to 800.",
    )
    differs = (
        "It is a mean over its window, with a large random error of few realizations; the pathways "
        "are identified in turn."
    )
    cites = ("ludvig2011",)

    def _intrinsic(self, ensemble: Ensemble) -> base.Method:
        if base.whole_samples(self.window / 2, ensemble):
            return ShortDataSegments(self.max_lag, self.window)
        return EnsembleIRF(self.max_lag)

    def _response(self, drive: Array, output: Array, ensemble: Ensemble) -> Array:
        half, count = base.whole_samples(self.window / 2, ensemble), np.ones(len(output.T))
        moments = *alternating.response_moments(drive, output), np.mean(output * output, axis=0)
        count, *sums = (sliding_sum(each, half, half) for each in (count, *moments))
        phi, cross, power = (np.swapaxes(each.T / count, 0, -1) for each in sums)
        return truncated(phi, cross, power, count * len(drive)).weights
