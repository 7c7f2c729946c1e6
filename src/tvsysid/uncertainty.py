"""How sure an estimate is, without assumptions on the noise: identification of realizations drawn with replacement."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping

import attrs
import numpy as np

from tvsysid.checked import Frozen
from tvsysid.errors import DataQualityWarning, InputError, describe_error
from tvsysid.estimates import read_only
from tvsysid.methods.apply import Identifies, apply
from tvsysid.models import Model
from tvsysid.numerics.bands import critical_value, mean_and_spread
from tvsysid.preprocess import bootstrap_weights
from tvsysid.showing import Progress, reported
from tvsysid.signals import Array, Ensemble

__all__ = ["Bootstrap", "bootstrap"]

FEWEST = 2  # draws, and realizations, without which there is no spread


@attrs.frozen(eq=False, repr=False)
class Bootstrap(Frozen):
    """Estimates from ensembles drawn with replacement, and the bands that follow.

    ``model`` is identified from the ensemble as it is, of so many ``realizations``. ``draws``
    holds what each draw gave of each quantity, shape (draw, time), or over the measured variable
    that it is an estimate over: NaN where not identified, means over realizations where the
    method tells these apart. So many draws of the ``count`` ``failed``; they are all NaN.
    """

    model: Model
    realizations: int
    draws: Mapping[str, Array]
    failed: int
    count: int

    def __attrs_post_init__(self) -> None:
        super().__attrs_post_init__()
        draws = {name: read_only(values) for name, values in self.draws.items()}
        object.__setattr__(self, "draws", draws)

    def __len__(self) -> int:
        return self.count

    def __repr__(self) -> str:
        failed = f", {self.failed} failed," if self.failed else ""
        found = "no quantity"
        if self.draws:
            name = "stiffness" if "stiffness" in self.draws else next(iter(self.draws))
            _, deviation = mean_and_spread(self.draws[name])
            known = np.isfinite(deviation)
            unit = self.model.estimates[name].unit.replace("N m", "N·m")
            size = (
                f"±{deviation[known].mean():.2g} {unit} (standard deviation)"
                if known.any()
                else "not known"
            )
            found = f"{name} {size}"
        return f"Bootstrap({len(self)} draws{failed} of {self.model.method}: {found})"

    def band(
        self, quantity: str = "stiffness", level: float = 0.95, simultaneous: bool = False
    ) -> tuple[Array, Array]:
        r"""Lower and upper limits of the band about the model's estimate of a quantity, each of the shape of a draw.

        It holds the true value with the probability ``level``, between 0 and 1: at each time by
        itself, or, if it is ``simultaneous``, at all times together. NaN where fewer than two draws
        have an estimate.

        Raises
        ------
        InputError
            For a level that is not between 0 and 1, or a quantity that was not drawn.

        Notes
        -----
        For the simultaneous band, each draw's largest distance from the draws' mean, in standard deviations at its
        time, is one of a sample of what the estimate's own will be. The band is wider than that of single times by the
        ratio of that sample's ``level`` quantile to theirs, and never narrower:

        .. math:: \frac{q\left(\max_t |k_b(t) - \bar k(t)| / s(t)\right)}{z}

        with z the quantile of the normal distribution. The quantile of so few draws is coarse: of a
        hundred, 95 % is the fifth largest.

        References
        ----------
        Davison and Hinkley 1997, Bootstrap Methods and their Application, section 4.2.4.
        """
        if quantity not in self.draws:
            raise InputError(
                f"band: there is no {quantity!r}; the quantities are {', '.join(self.draws)}"
            )
        draws = self.draws[quantity]
        mean, deviation = mean_and_spread(draws)
        freedom = self.realizations - 1
        # A draw's own variance is that of so many realizations over so many, not over one less.
        multiple = critical_value(level, np.array(float(freedom))) * math.sqrt(
            self.realizations / freedom
        )
        if simultaneous:
            with np.errstate(divide="ignore", invalid="ignore"):
                distances = np.abs(draws - mean) / deviation
            axes = tuple(range(1, draws.ndim))
            identified = np.isfinite(draws).any(axis=axes)
            largest = np.max(distances, axis=axes, where=np.isfinite(distances), initial=0.0)[
                identified
            ]
            at_one = float(critical_value(level, np.array(np.inf)))
            multiple *= (
                max(1.0, float(np.quantile(largest, level)) / at_one) if len(largest) else 1.0
            )
        estimate = _drawn(self.model, quantity)
        return estimate - multiple * deviation, estimate + multiple * deviation


def bootstrap(
    method: Identifies, ensemble: Ensemble, count: int, seed: int, progress: Progress | None = None
) -> Bootstrap:
    r"""Identify again and again from realizations drawn with replacement.

    .. math:: \hat k(t) \pm t_{R - 1}\, \sqrt{\frac{R}{R - 1}}\, s(t), \qquad
              s^2(t) = \frac{1}{B - 1} \sum_b \left(k_b(t) - \bar k(t)\right)^2

    with the quantile of Student's t for R - 1 degrees of freedom, which is exact for a mean of R
    realizations.

    Nothing is assumed of the noise but that the realizations do not depend on each other: its
    colour, a strength that changes over time, and behaviour that differs between realizations are
    all counted. It serves for any method, one's own included. It does not tell a bias, and is of no
    use with a handful of realizations.

    The band is built on the standard deviation, about the estimate from all realizations, because
    that needs some hundred draws where percentiles need a thousand, and covers better: bands of
    percentiles are too narrow with few realizations, and move with the bias that a draw has against
    the whole (docs/uncertainty.md has figures).

    The method is anything with ``identify(ensemble)``. Of the ensemble's realizations as many are
    drawn each time, ``count`` times (B; 100 give the standard deviation to 7 %); the same ``seed``
    gives the same draws. After each, ``progress`` is called with the draws done and their number;
    without it, a notebook shows a bar.

    Raises
    ------
    InputError
        For fewer than two draws or realizations, what the method refuses of the whole, or fewer
        than two draws that it can identify.

    Warns
    -----
    DataQualityWarning
        For what the method warns of the whole (what it warns of single draws is ignored), and if it
        cannot identify some draws: how many, and why the first. They are left out.

    References
    ----------
    Efron and Tibshirani 1993, An Introduction to the Bootstrap, chapters 6 and 13.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
    >>> simulation = joint.simulate(40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    >>> ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), period=2.0)
    >>> found = tv.uncertainty.bootstrap(tv.BasisIRF(), ensemble, count=20, seed=1)
    >>> lower, upper = found.band("stiffness", 0.95)
    >>> found.draws["stiffness"].shape, lower.shape
    ((20, 200), (200,))
    """
    if isinstance(method, type) or not callable(getattr(method, "identify", None)):
        raise InputError(
            "bootstrap: expected a method with identify(ensemble), got an object of "
            f"{type(method).__name__}"
            f"{'; make one: ' + method.__name__ + '()' if isinstance(method, type) else ''}"
        )
    if not isinstance(ensemble, Ensemble):
        raise InputError(f"bootstrap: expected an Ensemble, got {type(ensemble).__name__}")
    if len(ensemble) < FEWEST:
        raise InputError(
            f"bootstrap: expected at least {FEWEST} realizations to draw from, got {len(ensemble)}"
        )
    weights = bootstrap_weights(len(ensemble), len(ensemble), count, seed)
    if count < FEWEST:
        raise InputError(f"bootstrap: expected at least {FEWEST} draws, got {count}")
    label = repr(method)
    model = apply(method, ensemble)
    quantities = [name for name in model.estimates if _alike(model, model, name)]
    found = {name: np.full((count, *_drawn(model, name).shape), np.nan) for name in quantities}
    every = np.arange(len(ensemble))
    reasons = []
    with reported(progress, "drawing") as advance:
        for draw, times in enumerate(weights):
            try:
                drawn = ensemble.select(np.repeat(every, times))
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", DataQualityWarning)
                    own = apply(method, drawn)
                found = {name: draws for name, draws in found.items() if _alike(own, model, name)}
                for name, draws in found.items():
                    draws[draw] = _drawn(own, name)
            # One draw may be what no other is, and a method of one's own may raise anything.
            except Exception as error:
                reasons.append(describe_error(error))
            advance(draw + 1, count)
    if reasons:
        said = (
            f"{label} could not identify {len(reasons)} of {count} draws (the first: {reasons[0]})"
        )
        if count - len(reasons) < FEWEST:
            raise InputError(f"bootstrap: {said}; at least {FEWEST} are needed")
        warnings.warn(f"bootstrap: {said}; they are left out", DataQualityWarning, stacklevel=2)
    if missing := [name for name in model.estimates if name not in found]:
        said = (
            f"{', '.join(missing)}: the values that it is over depend on the draw, so that "
            "there is no band"
        )
        warnings.warn(f"bootstrap: {said}", DataQualityWarning, stacklevel=2)
    return Bootstrap(model, len(ensemble), found, len(reasons), count)


def _drawn(model: Model, quantity: str) -> Array:
    """Estimate, over time where that is its axis, the mean over realizations where the method tells these apart."""
    estimate = model.estimates.get(quantity)
    return (
        model.over_time(quantity)
        if estimate is None or estimate.axes[-1] == "time"
        else estimate.values
    )


def _alike(model: Model, other: Model, quantity: str) -> bool:
    """Whether two models have an estimate over the same values of the same axes."""
    axes = other.estimates[quantity].axes
    return axes[-1] == "time" or all(
        axis in model.coordinates
        and np.array_equal(model.coordinates[axis], other.coordinates[axis])
        for axis in axes
    )
