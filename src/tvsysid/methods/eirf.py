"""Ensemble impulse response function (eIRF)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import attrs

from tvsysid.methods import shared
from tvsysid.methods.base import Method, fitting_lags, whole_samples
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.models import Model
from tvsysid.numerics import Array, pseudoinverse
from tvsysid.signals import Ensemble
from tvsysid.validators import one_of, positive

Solving = Literal["mdl", "full"]


@attrs.frozen
class EnsembleIRF(Method):
    r"""Estimate a two-sided impulse response at each time, across realizations alone.

    .. math:: y_r(i) = \Delta t \sum_{j=-n}^{n} h(i, j)\, u_r(i - j), \qquad
              \varphi(i) = \Delta t\, \Phi(i)\, h(i)

    (equations 2 and 5 of van de Ruit et al. 2021). Nothing is assumed of how the joint changes in
    time; many realizations are needed.

    Parameters
    ----------
    max_lag
        Lags to either side in s.
    solver
        ``"mdl"``: pseudo-inverse truncated by minimum description length (Lortie & Kearney 2001);
        ``"full"``: least squares (MacNeil et al. 1992).
    order
        In which order ``"mdl"`` takes singular values: ``"natural"``, from the largest on, or
        ``"output"``, by the share of the output that they explain.

    Notes
    -----
    The description length uses the torque's variance about its mean over realizations (with
    R - 1), as the authors' code does. With the mean square instead, the ranks differ at a quarter
    of the samples. The two have the same meaning where the mean torque was subtracted, as it
    should be.

    Stiffness is the area under the impulse response (equation 20). Viscosity and inertia are those
    of a second-order fit to it, weighted by its inverse covariance
    (:func:`tvsysid.numerics.second_order.second_order_readout`). The diagnostics'
    ``second_order_agreement`` says how much of the torque that depends linearly on the angle the
    fit explains.

    The bands are those of least squares at each time by itself: realizations are seconds apart,
    so that noise of any colour is white across them. The noise variance is that of the residual
    without truncation. The bands do not count what the truncation leaves out. With no more
    realizations than lags there is none.
    """

    max_lag: float = attrs.field(default=0.12, validator=positive)
    solver: Solving = attrs.field(default="mdl", validator=one_of(Solving))
    order: pseudoinverse.Order = attrs.field(
        default="natural", validator=one_of(pseudoinverse.Order)
    )

    key = "eirf"
    title = "Ensemble impulse response function"
    assumptions = (
        "The movement is the same in all realizations.",
        "Nothing is assumed of the dynamics, or of how they change in time.",
        "Many realizations are needed: at least as many as lags, better a few hundred.",
    )
    differs = (
        "Every time is estimated by itself, with as many unknowns as lags: with few realizations, "
        "its random error is the largest by far, and it explains noise as well."
    )
    cites = ("macneil1992", "vanderuit2021")

    def fit(self, ensemble: Ensemble) -> ImpulseResponseModel:
        """Return the model of an ensemble."""
        lags = fitting_lags("EnsembleIRF", self.max_lag, ensemble)
        windows = shared.solve_windows(ensemble, lags, 0, self._solve)
        return shared.window_model(ensemble, ensemble, windows, half=0, needed=2 * lags + 2)

    def _solve(
        self, phi_uu: Array, phi_uy: Array, variance: Array, count: Array
    ) -> pseudoinverse.Solution:
        if self.solver == "full":
            return pseudoinverse.full(phi_uu, phi_uy)
        return pseudoinverse.truncated(phi_uu, phi_uy, variance, count, self.order)

    def _own_warnings(self, ensemble: Ensemble, model: Model) -> Iterator[str]:
        unknowns = 2 * whole_samples(self.max_lag, ensemble) + 1
        if len(ensemble) < 2 * unknowns:
            few = "fewer than" if len(ensemble) < unknowns else "less than twice"
            yield (
                f"{len(ensemble)} realizations are {few} the {unknowns} lags: the random error is "
                "large; record more, shorten max_lag, or use sds or birf"
            )
