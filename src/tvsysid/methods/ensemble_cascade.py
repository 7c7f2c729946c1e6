"""Ensemble cascade (TV-PC): both pathways of a joint with any change, across realizations."""

from __future__ import annotations

from collections.abc import Iterator

import attrs
import numpy as np

from tvsysid.methods import base
from tvsysid.methods.cascade import alternating
from tvsysid.methods.eirf import EnsembleIRF
from tvsysid.methods.sds import ShortDataSegments
from tvsysid.numerics.moments import sliding_sum, time_chunks
from tvsysid.numerics.pseudoinverse import truncated
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import not_negative, one_of, positive

ENOUGH = 500  # realizations that the literature asks for, at the least


@attrs.frozen
class EnsembleCascade(alternating.AlternatingCascade):
    r"""Identify intrinsic and reflex response at each time in turn, across realizations.

    .. math:: y(t) = \Delta t \sum_{\tau=-n}^{n} h(t, \tau)\, \theta(t - \tau)
              + \Delta t \sum_{\tau=d}^{m} p(t, \tau)\, f(t - \tau)

    The intrinsic pathway is identified by :class:`ShortDataSegments` (:class:`EnsembleIRF` without
    a window) from the torque less the reflex's, the reflex by the same truncated pseudo-inverse
    from the torque less the intrinsic one, and so on until the torque explained grows by less than
    0.001 points. f is a static function of the velocity.

    Parameters
    ----------
    max_lag
        Lags of the intrinsic response to either side in s; no more than the reflex's delay.
    delay, memory
        First and last lag of the reflex's response in s.
    window
        Time in s over which the joint is taken as constant, as in :class:`ShortDataSegments`. 0, as
        the paper has it, takes each time by itself, and needs 500 to 800 realizations.
    nonlinearity
        f: ``"rectifier"``, the velocity of stretch, rectified; ``"polynomial"``, of degree 5.

    Notes
    -----
    The direction of stretch, the scale of f and ``reflex_gain`` are those of
    :class:`BasisCascade`. The paper has a different static function at each time. Here the
    polynomial is the same at all times, because one for each time has more coefficients than the
    usual number of realizations determines.

    Realizations that do not have the memory recorded before them are left out. No bands are stated.

    References
    ----------
    Ludvig, Starret Visser, Giesbrecht & Kearney 2011, IEEE Trans. Biomed. Eng. 58, 1715-1723.
    """

    max_lag: float = attrs.field(default=0.04, validator=positive)
    delay: float = attrs.field(default=0.04, validator=not_negative)
    memory: float = attrs.field(default=0.5, validator=[positive, alternating.after_delay])
    window: float = attrs.field(default=0.10, validator=not_negative)
    nonlinearity: alternating.Nonlinearity = attrs.field(
        default="rectifier", validator=one_of(alternating.Nonlinearity)
    )

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
        half = base.whole_samples(self.window / 2, ensemble)
        phi, cross = alternating.response_moments(drive, output)
        times, lags = cross.shape
        count = sliding_sum(np.ones(times), half, half)
        power = sliding_sum(np.mean(output * output, axis=0), half, half) / count
        cross = sliding_sum(cross, half, half) / count[:, None]
        weights = np.empty_like(cross)
        for chunk in time_chunks(times, lags):
            begin, end = max(0, chunk.start - half), min(times, chunk.stop + half)
            summed = sliding_sum(phi[begin:end], half, half)[
                chunk.start - begin : chunk.stop - begin
            ]
            mean = summed / count[chunk, None, None]
            weights[chunk] = truncated(
                mean, cross[chunk], power[chunk], count[chunk] * len(drive)
            ).weights
        return weights

    def _own_warnings(self, ensemble: Ensemble) -> Iterator[str]:
        samples = 2 * base.whole_samples(self.window / 2, ensemble) + 1
        if samples * len(ensemble) < ENOUGH:
            yield (
                f"a window holds {samples * len(ensemble)} samples of all realizations, where the "
                f"literature asks for {ENOUGH} to 800 to know a reflex: the random error is large; "
                "record more, lengthen window, or use bpc or cascade"
            )
