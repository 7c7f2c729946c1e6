"""Compute bands by the bootstrap, without assumptions on the colour of the noise."""

from __future__ import annotations

import attrs
import numpy as np

from tvsysid.errors import without_quality_warnings
from tvsysid.methods.base import Method
from tvsysid.models import OVER_TIME, Estimate, Model, StandardError
from tvsysid.numerics.bands import mean_and_spread
from tvsysid.preprocess import bootstrap_weights
from tvsysid.signals import Ensemble
from tvsysid.validators import at_least

__all__ = ["bootstrap"]

MIN_DRAWS = 2  # minimum number of draws and of realizations; fewer have no standard deviation


def bootstrap(method: Method, ensemble: Ensemble, count: int, seed: int) -> Model:
    r"""Identify an ensemble, with bands from realizations drawn with replacement.

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

    Returns
    -------
    Model
        Model of the ensemble as it is. Its estimates over time have the standard errors of the
        bootstrap. Of a quantity with an estimate for each realization, it has the mean. An
        estimate over a measured variable keeps its own standard error.

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
    >>> model = tv.uncertainty.bootstrap(tv.BasisIRF(), ensemble, count=20, seed=1)
    >>> lower, upper = model.estimates["stiffness"].band(0.95)
    >>> lower.shape
    (200,)
    """
    realizations = len(ensemble)
    at_least(MIN_DRAWS).check("bootstrap", "count", count)
    at_least(MIN_DRAWS).check("bootstrap", "the number of realizations", realizations)
    model = method.identify(ensemble)
    weights = bootstrap_weights(realizations, realizations, count, seed)
    with without_quality_warnings():
        draws = [
            method.identify(ensemble.select(np.repeat(np.arange(realizations), times)))
            for times in weights
        ]
    freedom = realizations - 1
    estimates = dict(model.estimates)
    for name, estimate in estimates.items():
        if estimate.axes in OVER_TIME:
            _, deviation = mean_and_spread(np.array([each.over_time(name) for each in draws]))
            # The variance of a draw is that of R realizations over R, not over R - 1.
            error = StandardError(deviation * np.sqrt(realizations / freedom), freedom)
            estimates[name] = Estimate(model.over_time(name), estimate.unit, error=error)
    return attrs.evolve(model, estimates=estimates)
