"""A stretch reflex beside an adaptive stiffness.

If there is one, its coefficients are further constants.
"""

from __future__ import annotations

from collections.abc import Iterator

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods.adaptive.mixture import Mixture
from tvsysid.methods.adaptive.moments import MIN_REALIZATIONS, SHORTEST, Constants, Signals
from tvsysid.methods.cascade.cascade import JointCascade
from tvsysid.methods.cascade.columns import readout
from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS, reflex_test_of
from tvsysid.methods.cascade.result import JointCascadeModel, model
from tvsysid.numerics import Array
from tvsysid.numerics.moments import row_blocks
from tvsysid.signals import Ensemble


@attrs.frozen(eq=False, kw_only=True)
class WithReflex(Signals):
    """Signals of a joint with a reflex.

    Angle, velocity and acceleration come first. Then follow the angle's differences of higher order
    (the intrinsic response lasts 40 ms to either side), the reflex's columns, and their derivatives
    by its shape. ``columns`` (signal, realization, time) are those of realizations with a history.
    """

    columns: Array
    beside: JointCascadeModel
    readout: Array

    def blocks(self) -> Iterator[Array]:
        """Yield the signals of one block of realizations after another."""
        for some in row_blocks(*self.columns.shape[1:]):
            yield self.columns[:, some]

    def viscosity(self, mixture: Mixture, constants: Constants) -> Mixture:
        """Return the viscosity of a second-order fit to the whole intrinsic response.

        ``mixture`` is that of the velocity's coefficient.
        """
        own, further = self.readout[1, 1], self.readout[1, 3:]
        rest = slice(2, 2 + len(further))
        added = float(further @ constants.values[rest])
        sure = float(further @ constants.covariance[rest, rest] @ further)
        return mixture._replace(
            means=own * mixture.means + added, variances=own**2 * mixture.variances + sure
        )

    def stiffness(self, mean: float, constants: Constants) -> float:
        """Return the stiffness of the same fit, from the mean of the angle's coefficient."""
        weights = self.readout[0, 2:]
        return float(self.readout[0, 0] * mean + weights @ constants.values[1 : 1 + len(weights)])

    def inertia(self, constants: Constants) -> tuple[float, float]:
        """Return the inertia of the same fit, with its variance."""
        weights = self.readout[2, 2:]
        rest = slice(1, 1 + len(weights))
        return float(weights @ constants.values[rest]), float(
            weights @ constants.covariance[rest, rest] @ weights
        )


def with_reflex(
    ensemble: Ensemble, emg: str | None, known: JointCascadeModel | None = None
) -> WithReflex | None:
    """Return the signals of a joint with a reflex, if held-out realizations show one.

    If the reflex is ``known``, it is not tested. Return None also if the history of too few
    realizations is known. A channel of EMG may drive the reflex.
    """
    method = JointCascade(emg=emg)
    try:
        if known is not None:
            chosen = method.refitted(ensemble, known.hyperparameters)
        elif len(ensemble) < MIN_TESTED_REALIZATIONS:
            return None
        elif emg is not None:
            chosen = method.solved(ensemble)
        elif (test := reflex_test_of(ensemble)).shown:
            chosen = method.solved(ensemble, "positive" if test.direction > 0 else "negative")
        else:
            return None
    except InputError:  # realizations are too short
        return None
    if not chosen.shown:
        return None
    found, problem = chosen.fit, chosen.fit.problem
    data, rate, lags = problem.data, ensemble.sampling_rate, chosen.search.lags
    times = data.times
    if len(data.rows) < MIN_REALIZATIONS or data.torque.shape[1] < SHORTEST:
        return None
    signals, torque = data.signals, data.torque

    first = data.bases[0].shape[1] + data.bases[1].shape[1] + 1
    gains = problem.positive[:, problem.own :]
    return WithReflex(
        rate=rate,
        edges=(times.start, ensemble.samples - times.stop),
        realizations=(len(torque), len(torque) - 1),
        holds=np.concatenate([[0.0, 0.0], found.precision()[first:]]),
        positive=np.pad(gains[gains.any(axis=1)], ((0, 0), (len(signals) - 1, len(problem.free)))),
        columns=np.concatenate([signals, found.columns_and_slopes(), torque[None]]),
        beside=model(repr(method), chosen),
        readout=readout(lags, rate),
    )
