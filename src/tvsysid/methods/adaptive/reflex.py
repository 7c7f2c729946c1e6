"""A stretch reflex beside an adaptive stiffness: its coefficients are constants more, if there is one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.methods.adaptive.mixture import Mixture
from tvsysid.methods.adaptive.moments import MIN_REALIZATIONS, SHORTEST, Constants, Signals
from tvsysid.methods.cascade.cascade import JointCascade
from tvsysid.methods.cascade.regressors import MANY, Columns, Rows, readout
from tvsysid.methods.cascade.result import JointCascadeModel, model
from tvsysid.methods.cascade.shape import TERMS
from tvsysid.numerics import Array
from tvsysid.numerics.moments import row_blocks
from tvsysid.quality.reflexes import reflex_test_of
from tvsysid.quality.statistics import LEAST_REALIZATIONS
from tvsysid.signals import Ensemble


@dataclass(frozen=True, eq=False, kw_only=True)
class WithReflex(Signals):
    """Signals of a joint with a reflex.

    Behind angle, velocity and acceleration follow the angle's differences of higher order (the intrinsic response lasts
    40 ms to either side), the reflex's columns, and their derivatives by its shape. These ``columns`` are known of some
    ``rows``, at ``times``: those with a history.
    """

    columns: Columns
    rows: NDArray[np.int64]
    times: slice
    beside: JointCascadeModel
    readout: Array

    def blocks(self, low: bool = False) -> Iterator[Array]:
        """All of them: the differences take up what decimation does to the acceleration."""
        for some in row_blocks(len(self.rows), MANY * self.times.stop):
            yield self.columns(self.rows[some])[..., self.times]

    def viscosity(self, mixture: Mixture, constants: Constants) -> Mixture:
        """Of a second-order fit to the whole intrinsic response, from the mixture of its velocity's coefficient."""
        own, further = self.readout[1, 1], self.readout[1, 3:]
        rest = slice(2, 2 + len(further))
        added = float(further @ constants.values[rest])
        sure = float(further @ constants.covariance[rest, rest] @ further)
        return mixture._replace(means=own * mixture.means + added, variances=own**2 * mixture.variances + sure)

    def stiffness(self, mean: float, constants: Constants) -> float:
        """Of the same fit, from the mean of the angle's coefficient."""
        weights = self.readout[0, 2:]
        return float(self.readout[0, 0] * mean + weights @ constants.values[1 : 1 + len(weights)])

    def inertia(self, constants: Constants) -> tuple[float, float]:
        """Of the same fit, with its variance."""
        weights = self.readout[2, 2:]
        rest = slice(1, 1 + len(weights))
        return float(weights @ constants.values[rest]), float(weights @ constants.covariance[rest, rest] @ weights)


def with_reflex(ensemble: Ensemble, known: JointCascadeModel | None = None) -> WithReflex | None:
    """Signals of a joint with a reflex, if held-out realizations show one; or with one that is ``known``.

    None also if too little is known of the history of enough realizations.
    """
    method = JointCascade()
    try:
        if known is not None:
            chosen = method.refitted(ensemble, known.hyperparameters)
        elif len(ensemble) >= LEAST_REALIZATIONS and (test := reflex_test_of(ensemble)).shown:
            chosen = method.solved(ensemble, "positive" if test.direction > 0 else "negative")
        else:
            return None
    except InputError:  # realizations are too short
        return None
    problem, found = chosen.fit.problem, chosen.fit.found
    data, rate, lags = problem.data, ensemble.sampling_rate, chosen.search.lags
    count = data.fitted.sum(axis=1)
    rows = np.flatnonzero(count == count.max())
    times = np.flatnonzero(data.fitted[rows].all(axis=0))
    if len(rows) < MIN_REALIZATIONS or len(times) < SHORTEST or np.ptp(times) + 1 != len(times):
        return None
    signals, torque, reflex = data.signals, data.torque, problem.columns_and_slopes(found)

    def columns(some: Rows) -> Array:
        return np.concatenate([signals[:, some], reflex(some), torque[None, some]])

    first = data.bases[0].shape[1] + data.bases[1].shape[1] + 1
    weights = (found.scale / found.spread)[first:] ** 2
    gains = problem.positive[len(data.torque[0]) :, len(data.own.cross) :]
    slopes = [found.solved.noise_variance / TERMS[name].spread ** 2 for name in problem.free]
    inside = slice(int(times[0]), int(times[-1]) + 1)
    return WithReflex(
        rate=rate,
        edges=(inside.start, torque.shape[1] - inside.stop),
        realizations=(len(rows), len(rows) - 1),
        share=data.share,
        holds=np.concatenate([[0.0, 0.0], weights, slopes]),
        positive=np.pad(gains, ((0, 0), (len(signals) - 1, len(slopes)))),
        columns=columns,
        rows=rows,
        times=inside,
        beside=model(repr(method), chosen, only_gain=True),
        readout=readout(lags, rate),
    )
