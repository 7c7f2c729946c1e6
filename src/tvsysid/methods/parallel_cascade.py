"""Parallel cascade (PC): both pathways of a joint that does not change."""

from __future__ import annotations

import attrs
import numpy as np

from tvsysid.methods import base, shared
from tvsysid.methods.cascade.alternating import constant_cascade, two_pathways
from tvsysid.methods.cascade.method import TwoPathwayMethod
from tvsysid.methods.cascade.pathways import TwoPathwayModel, history
from tvsysid.models import Diagnostics
from tvsysid.numerics.second_order import agreement, second_order_readout
from tvsysid.signals import Ensemble
from tvsysid.validators import positive

MIN_SAMPLES_PER_LAG = 5  # of the reflex's response


@attrs.frozen
class ParallelCascade(TwoPathwayMethod):
    r"""Identify intrinsic and reflex pathway of a joint that does not change, in turn.

    .. math:: y(t) = \Delta t \sum_{j=-n}^{n} h_j\, \theta(t - j)
              + \Delta t \sum_{i=0}^{m} p_i\, f(t - i), \qquad
              f = s \max(s\, \dot\theta, 0)

    The intrinsic response is fitted to the torque less the reflex's, then the reflex's to the
    torque less the intrinsic one, and so on until the torque explained grows by less than 0.05
    points, or ten times. What separates the two is that the intrinsic lags end where the reflex's
    delay does.

    Parameters
    ----------
    max_lag
        Lags of the intrinsic response to either side in s; no more than the reflex's delay.
    memory
        Lags of the reflex's response in s. The authors' 1 s needs as much context, or realizations
        that follow each other.

    Notes
    -----
    The direction s of stretch is the one that explains more of the torque. ``reflex_gain`` is the
    area under the reflex's response, in N·m·s/rad.

    Both responses are truncated by description length, the directions that explain most first.
    The model is constant. Where the joint changes, it is an average. The velocity is that of the
    angle as it was recorded. The authors take the decimated velocity, which gives up to 15 % more
    stiffness where the perturbation is made of pulses. The first turn gives the intrinsic pathway
    all that it can explain. Stiffness is therefore 2 to 3 % too high if the reflex is strong. No
    bands are stated; :func:`tvsysid.uncertainty.bootstrap` gives them.

    The authors' code can also fit a polynomial of the velocity, as :class:`SubspaceCascade` does.

    References
    ----------
    Kearney, Stein & Parameswaran 1997, IEEE Trans. Biomed. Eng. 44, 493-504.
    """

    max_lag: float = attrs.field(default=0.04, validator=positive)
    memory: float = attrs.field(default=0.5, validator=positive)

    key = "pc"
    title = "Parallel cascade"
    assumptions = (
        "The joint does not change in time.",
        "The intrinsic response ends before the reflex's delay does; nothing else is assumed of "
        "either's dynamics.",
        "The reflex answers the velocity of stretch.",
    )
    differs = (
        "It is one constant, some mean where the joint changes; the pathways are identified in "
        "turn, so that each may keep a part of the other's torque."
    )
    cites = ("kearney1997",)
    time_invariant = True

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return a reason to skip if hardly any sample has the reflex's memory before it."""
        before = base.whole_samples(self.memory, ensemble)
        unknown = np.isnan(history(ensemble, ensemble.angle, before)).sum()
        known = len(ensemble) * ensemble.samples - int(unknown)
        if known >= MIN_SAMPLES_PER_LAG * (before + 1):
            return None
        return (
            f"only {known} samples have {self.memory:g} s recorded before them; shorten memory, or "
            "cut with more context (--context)"
        )

    def fit(self, ensemble: Ensemble) -> TwoPathwayModel:
        """Return the model of an ensemble."""
        lags = base.fitting_lags("ParallelCascade", self.max_lag, ensemble)
        before = max(2 * lags, base.whole_samples(self.memory, ensemble))
        drive, turn = constant_cascade(ensemble, lags, before)
        (found, gram, cross), late = turn.details
        rate = ensemble.sampling_rate
        readout, fitted = second_order_readout(gram, cross, found.inverse, rate)
        # Of so many samples, chance explains nothing.
        agrees = agreement(fitted, float(found.explained) - fitted, 0.0)
        times = ensemble.samples - 2 * base.missing_edge(lags, ensemble)
        weights, impedance = (
            np.tile(each, (times, 1)) for each in (found.weights, readout @ cross)
        )
        diagnostics = Diagnostics(
            float(found.rank + late.solution.rank), details={"second_order_agreement": agrees}
        )
        plain = shared.impulse_response_model(ensemble, weights, impedance, diagnostics, {})
        reflex = np.tile(late.solution.weights, (ensemble.samples, 1))
        return two_pathways(ensemble, plain, drive, reflex, 0)
