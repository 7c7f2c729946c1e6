"""Signals of realizations that are regressed: angle, its derivatives, a reflex, and torque."""

from __future__ import annotations

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods.base import missing_edge
from tvsysid.methods.cascade.cascade import JointCascade, JointCascadeModel, model_of
from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS, reflex_test_of
from tvsysid.methods.cascade.search import Selection
from tvsysid.methods.shared import HALF_WIDTH, independent_realizations
from tvsysid.numerics import Array
from tvsysid.signals import Ensemble

MIN_REALIZATIONS = 4
MIN_SAMPLES = 16  # of a realization that have derivatives


@attrs.frozen(eq=False, kw_only=True)
class Signals:
    """Signals of realizations, and what is known of their coefficients.

    Parameters
    ----------
    columns
        Angle, velocity, acceleration, further regressors, and torque, shape (signal, realization,
        time). The angle's coefficient is free at each time, the others are constants.
    edges
        Samples at either end of a realization that are missing.
    independent
        Number of independent realizations.
    prior_precision
        Precision of the constants' priors, times the variance of the noise, shape (constant,).
    reflex
        Model of the reflex whose columns are among the regressors. The torque lacks what the change
        of its viscosity over time adds.
    change_covariance
        Covariance (time, time) of that change.
    """

    columns: Array
    edges: tuple[int, int]
    independent: int
    prior_precision: Array
    reflex: JointCascadeModel | None = None
    change_covariance: Array | float = 0.0

    @classmethod
    def of_second_order(cls, ensemble: Ensemble) -> Signals:
        """Return the signals of an ensemble without a reflex."""
        edge = missing_edge(HALF_WIDTH, ensemble)
        signals = *ensemble.derivatives(), ensemble.torque[:, ensemble.core]
        return cls(
            columns=np.stack(signals)[..., edge : ensemble.samples - edge],
            edges=(edge, edge),
            independent=independent_realizations(ensemble),
            prior_precision=np.zeros(2),
        )

    @classmethod
    def with_reflex(cls, ensemble: Ensemble, selection: Selection) -> Signals:
        """Return the signals of an ensemble with the selected reflex.

        The columns after the acceleration are the angle's differences of higher order (the
        intrinsic response lasts 40 ms to either side), the reflex's columns, and their derivatives
        by its shape.
        """
        fit, data = selection.fit, selection.fit.data
        first = data.starts[2] + 1  # after the inertia
        change = data.features(np.eye(1, len(data.starts), 1)[0])[data.times]
        change = change - change.mean(axis=0)  # the mean is a constant that is estimated again
        torque = data.torque - change @ fit.posterior.mean[: data.own] * data.signals[1]
        parts = data.signals, fit.columns, fit.slopes(), torque[None]
        return cls(
            columns=np.concatenate(parts),
            edges=(data.times.start, ensemble.samples - data.times.stop),
            independent=len(data.torque) - 1,
            prior_precision=np.concatenate([[0.0, 0.0], fit.precision()[first:]]),
            reflex=model_of(repr(JointCascade(emg=selection.search.emg)), selection),
            change_covariance=change @ fit.covariance[: data.own, : data.own] @ change.T,
        )


def select_reflex(ensemble: Ensemble, emg: str | None) -> Selection | None:
    """Return the fit with a reflex if held-out realizations show one, else None.

    A channel of EMG may drive the reflex.
    """
    if len(ensemble) < MIN_TESTED_REALIZATIONS:
        return None
    try:
        if emg is None and not reflex_test_of(ensemble).shown:
            return None
        selection = JointCascade(emg=emg).search(ensemble).select()
    except InputError:  # realizations are too short
        return None
    return selection if selection.shown else None
