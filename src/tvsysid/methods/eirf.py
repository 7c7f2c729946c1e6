"""Ensemble impulse response function (eIRF)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from tvsysid.impedance import static_stiffness
from tvsysid.methods.base import (
    EXCITED_ABOVE,
    Method,
    check_choice,
    check_positive,
    fitting_lags,
    missing_edge,
    padded,
    whole_samples,
)
from tvsysid.models import Diagnostics, ImpulseResponseModel
from tvsysid.numerics import pseudoinverse
from tvsysid.numerics.moments import lagged_moments
from tvsysid.numerics.pseudoinverse import Order, Solution
from tvsysid.signals import Ensemble

Solver = Literal["mdl", "full", "lstsq"]


@dataclass(frozen=True)
class EnsembleIRF(Method):
    r"""A two-sided impulse response at each time, estimated across realizations alone.

    .. math:: y_r(i) = \Delta t \sum_{j=-n}^{n} h(i, j)\, u_r(i - j), \qquad
              \varphi(i) = \Delta t\, \Phi(i)\, h(i)

    (equations 2 and 5 of van de Ruit et al. 2021). Nothing is assumed of how the joint changes in time; many
    realizations are needed.

    Parameters
    ----------
    max_lag
        Lags to either side in s.
    solver
        ``"mdl"``: correlations, pseudo-inverse truncated by minimum description length (Lortie & Kearney 2001);
        ``"full"``: correlations, full rank; ``"lstsq"``: singular value decomposition of the lagged inputs themselves
        (MacNeil et al. 1992).
    order
        In which order ``"mdl"`` takes singular values: ``"natural"``, from the largest on, or ``"output"``, by the
        share of the output that they explain.

    Notes
    -----
    The description length uses the torque's variance about its mean over realizations (with R - 1), as the authors'
    code does: with the mean square instead, the ranks differ at a quarter of the samples. The two agree in what they
    mean where the mean torque was subtracted, as it should be.

    Stiffness is the area under the impulse response (equation 20); viscosity and inertia are not identified yet.
    """

    max_lag: float = 0.12
    solver: Solver = "mdl"
    order: Order = "natural"

    key: ClassVar[str] = "eirf"
    title: ClassVar[str] = "Ensemble impulse response function"
    assumptions: ClassVar[tuple[str, ...]] = (
        "Behaviour is the same in all realizations.",
        "Nothing is assumed of the dynamics, or of how they change in time.",
        "Many realizations are needed: at least as many as lags, better a few hundred.",
    )

    def __post_init__(self) -> None:
        check_positive(self, max_lag=self.max_lag)
        check_choice(self, "solver", Solver)
        check_choice(self, "order", Order)

    def _identify(self, ensemble: Ensemble) -> ImpulseResponseModel:
        lags = fitting_lags("EnsembleIRF", self.max_lag, ensemble)
        missing = missing_edge(lags, ensemble)
        reach = slice(ensemble.context + missing - lags, ensemble.angle.shape[1] - (ensemble.context + missing - lags))
        angle, torque = ensemble.angle[:, reach], ensemble.torque[:, reach]
        if self.solver == "lstsq":
            solution = pseudoinverse.direct(angle, torque, lags)
        else:
            phi_uu, phi_uy, square, mean = lagged_moments(angle, torque, lags)
            if self.solver == "full":
                solution = pseudoinverse.full(phi_uu, phi_uy)
            else:
                count = len(ensemble)
                variance = (square - mean**2) * (count / max(count - 1, 1))
                solution = pseudoinverse.truncated(phi_uu, phi_uy, variance, count, self.order)
        return impulse_response_model(repr(self), ensemble, solution, lags, missing)

    def _needed_band(self, ensemble: Ensemble) -> tuple[float, float]:
        return 1 / (2 * self.max_lag), EXCITED_ABOVE

    def _doubts(self, ensemble: Ensemble) -> Iterator[str]:
        unknowns = 2 * whole_samples(self.max_lag, ensemble) + 1
        if len(ensemble) < 2 * unknowns:
            few = "fewer than" if len(ensemble) < unknowns else "less than twice"
            yield (
                f"{len(ensemble)} realizations are {few} the {unknowns} lags: the fit at each time is hardly "
                "determined and its random error explodes; record more, shorten max_lag, or use sds or birf"
            )


def impulse_response_model(
    method: str, ensemble: Ensemble, solution: Solution, lags: int, missing: int
) -> ImpulseResponseModel:
    """Model from the weights at each time; ``missing`` samples at either end become NaN."""
    response = padded(solution.weights * ensemble.sampling_rate, missing)
    unknown = np.full(ensemble.samples, np.nan)
    return ImpulseResponseModel(
        method=method,
        sampling_rate=ensemble.sampling_rate,
        time=ensemble.time,
        stiffness=static_stiffness(response, 1 / ensemble.sampling_rate),
        viscosity=unknown,
        inertia=unknown,
        impulse_response=response,
        lags=np.arange(-lags, lags + 1) / ensemble.sampling_rate,
        diagnostics=Diagnostics(float(solution.rank.mean()), padded(solution.rank.astype(float), missing)),
    )
