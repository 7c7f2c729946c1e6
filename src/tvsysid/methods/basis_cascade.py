"""Basis cascade (BPC): both pathways of a joint that changes by a sum of basis functions."""

from __future__ import annotations

import attrs
import numpy as np

from tvsysid.methods import birf, shared
from tvsysid.methods.cascade import alternating
from tvsysid.numerics.bases import A_BASIS, Basis, CubicBSplines, evaluate
from tvsysid.numerics.moments import expanded
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import one_of, optional, positive, text


@attrs.frozen
class BasisCascade(alternating.AlternatingCascade):
    r"""Identify intrinsic and reflex response in turn, each as a sum of basis functions.

    .. math:: y(t) = \Delta t \sum_{\tau=-n}^{n} \sum_j
              \lambda_{\tau j} \Lambda_j(t)\, \theta(t - \tau)
              + \Delta t \sum_{\tau=d}^{m} \sum_j \mu_{\tau j} \Lambda_j(t)\, f(t - \tau)

    The intrinsic pathway is identified by :class:`BasisIRF` (``model="irf"``) from the torque less
    the reflex's, the reflex with the same basis and prior from the torque less the intrinsic one,
    and so on until the torque explained grows by less than 0.001 points. f is the velocity of
    stretch, rectified, or EMG.

    Parameters
    ----------
    max_lag
        Lags of the intrinsic response to either side in s, no more than the reflex's delay. The
        reflex's response begins there; with EMG, it begins at 0.
    memory
        Last lag of the reflex's response in s.
    basis
        Basis functions of normalised time; see :class:`BasisIRF`.
    prior
        On the coefficients of either pathway: ``"ridge"``, one precision for all, chosen by
        evidence, as the authors have it; ``"ard"``, one for each, which takes some seconds;
        ``"none"``.
    emg
        Channel, rectified, that drives the reflex instead of the velocity.

    Notes
    -----
    The direction of stretch is the one that explains more of the torque. ``reflex_gain`` is the
    area under the reflex's response at a time, in N·m·s/rad (with EMG, torque by the unit of EMG).
    It belongs to the time of the torque, which follows the stretch by the mean lag of the muscle.

    The authors also take slow voluntary torque out, by polynomials of time in each realization.
    ``cascade`` does without them.

    With the velocity, the papers identify a muscle of second order whose coefficients change, by
    refined instrumental variables. Here the reflex has a free response, as theirs with EMG. In
    simulations, their muscle showed no bias of the gain (here 0.75 N·m·s/rad), but five times the
    random error of the gain and 1.6 times the error of the stiffness. It explained less torque of a
    walking ankle.

    Realizations whose memory is not recorded are left out. No bands are stated: the bands of one
    pathway would not count the error of the other.

    References
    ----------
    Guarin & Kearney 2017, Front. Comput. Neurosci. 11:51, and 2018, IEEE Trans. Neural Syst.
    Rehabil. Eng. 26.
    """

    max_lag: float = attrs.field(default=0.04, validator=positive)
    memory: float = attrs.field(default=0.5, validator=positive)
    basis: Basis = attrs.field(factory=CubicBSplines, validator=A_BASIS)
    prior: birf.Prior = attrs.field(default="ridge", validator=one_of(birf.Prior))
    emg: str | None = attrs.field(default=None, validator=optional(text))

    key = "bpc"
    title = "Basis parallel cascade"
    assumptions = (
        "Behaviour is the same in all realizations.",
        "Both pathways change as sums of the basis functions chosen; faster changes are missed.",
        "The intrinsic response ends before the reflex's delay does.",
        "The reflex answers the velocity of stretch, or EMG.",
    )
    differs = (
        "It changes as its basis functions can; the pathways are identified in turn, so that each "
        "may keep a part of the other's torque."
    )
    cites = ("guarin2017", "guarin2018")

    def _intrinsic(self, ensemble: Ensemble) -> birf.BasisIRF:
        return birf.BasisIRF(max_lag=self.max_lag, basis=self.basis, model="irf", prior=self.prior)

    def _response(self, drive: Array, output: Array, ensemble: Ensemble) -> Array:
        functions = evaluate(self.basis, ensemble.samples)
        phi, cross = (len(drive) * each for each in alternating.response_moments(drive, output))
        right = (cross.T @ functions).ravel()
        square = float(np.sum(output**2))
        moments = shared.Moments(expanded(phi, functions), right, square, output.size)
        found = shared.PRIORS[self.prior](moments)
        return functions @ found.mean.reshape(cross.shape[1], -1).T
