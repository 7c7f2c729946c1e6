"""Compute bands by the bootstrap, without assumptions on the colour of the noise."""

from __future__ import annotations

from collections.abc import Mapping

import attrs
import numpy as np

from tvsysid.errors import without_quality_warnings
from tvsysid.methods.base import Method
from tvsysid.models import OVER_TIME, Model
from tvsysid.numerics.bands import critical_value, mean_and_spread
from tvsysid.preprocess import bootstrap_weights
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import at_least

__all__ = ["Bootstrap", "bootstrap"]

MIN_DRAWS = 2  # minimum number of draws and of realizations; fewer have no standard deviation


@attrs.frozen(eq=False, repr=False)
class Bootstrap:
    """Estimates from ensembles drawn with replacement, and their bands.

    Parameters
    ----------
    model
        Model of the ensemble as it is.
    realizations
        Number of realizations in the ensemble.
    draws
        Estimates over time of each draw by quantity, shape (draw, time). NaN where not identified.
        Means over realizations where the method has an estimate for each of them.
    """

    model: Model
    realizations: int
    draws: Mapping[str, Array]

    def __repr__(self) -> str:
        return f"Bootstrap({', '.join(self.draws)} of {self.model.method})"

    def band(self, quantity: str = "stiffness", level: float = 0.95) -> tuple[Array, Array]:
        """Return the lower and upper limit of the band around the model's estimate of a quantity.

        The band contains the true value with the probability ``level``, between 0 and 1, at each
        single time. It is NaN where fewer than two draws have an estimate.

        Raises
        ------
        InputError
            For a level that is not between 0 and 1.
        """
        freedom = np.array(self.realizations - 1.0)
        _, deviation = mean_and_spread(self.draws[quantity])
        # The variance of a draw is that of R realizations over R, not over R - 1.
        width = deviation * np.sqrt(self.realizations / freedom) * critical_value(level, freedom)
        estimate = self.model.over_time(quantity)
        return estimate - width, estimate + width


def bootstrap(method: Method, ensemble: Ensemble, count: int, seed: int) -> Bootstrap:
    r"""Estimate bands from realizations drawn with replacement.

    .. math:: \hat k(t) \pm t_{R - 1}\, \sqrt{\frac{R}{R - 1}}\, s(t), \qquad
              s^2(t) = \frac{1}{B - 1} \sum_b \left(k_b(t) - \bar k(t)\right)^2

    with the quantile of Student's t for R - 1 degrees of freedom, which is exact for a mean of R
    realizations.

    The only assumption is that realizations are independent. The band is valid for coloured noise,
    for noise whose strength changes over time, and for movements that differ between realizations.
    It works with any method, your own included. It does not cover bias, and needs more than a
    handful of realizations.

    The band is the estimate from all realizations plus and minus a multiple of the standard
    deviation over draws. This needs some 100 draws, where percentiles need 1000. It also covers
    better: bands of percentiles are too narrow with few realizations, and shift with the bias of
    the draws.

    Parameters
    ----------
    method
        Method that identifies each draw.
    ensemble
        Realizations. Each draw has as many.
    count
        Number of draws (B), at least two. 100 give the standard deviation to 7 %.
    seed
        Random seed. The same seed gives the same draws.

    Raises
    ------
    InputError
        For fewer than two draws or realizations, and for an ensemble that the method refuses.

    Warns
    -----
    DataQualityWarning
        If the method warns about the ensemble; its warnings about draws are ignored.

    References
    ----------
    Efron and Tibshirani 1993, An Introduction to the Bootstrap, chapters 6 and 13.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
    >>> simulation = joint.simulate(40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    >>> ensemble = tv.preprocess.segment(
    ...     tv.preprocess.decimate(simulation.recording, 100), period=2.0)
    >>> estimates = tv.uncertainty.bootstrap(tv.BasisIRF(), ensemble, count=20, seed=1)
    >>> lower, upper = estimates.band("stiffness", 0.95)
    >>> estimates.draws["stiffness"].shape, lower.shape
    ((20, 200), (200,))
    """
    at_least(MIN_DRAWS).check("bootstrap", "count", count)
    at_least(MIN_DRAWS).check("bootstrap", "the number of realizations", len(ensemble))
    model = method.identify(ensemble)
    weights = bootstrap_weights(len(ensemble), len(ensemble), count, seed)
    with without_quality_warnings():
        found = [
            method.identify(ensemble.select(np.repeat(np.arange(len(ensemble)), times)))
            for times in weights
        ]
    draws = {
        name: np.array([each.over_time(name) for each in found])
        for name, estimate in model.estimates.items()
        if estimate.axes in OVER_TIME
    }
    return Bootstrap(model, len(ensemble), draws)
