"""What kernel-based regression returns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tvsysid.methods.kbr.kernel import Kernel
from tvsysid.methods.kbr.record import clocks_of, lagged, times_of
from tvsysid.models import SecondOrderModel
from tvsysid.signals import Ensemble

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class KernelModel(SecondOrderModel):
    """Impedance as a function of time that holds at any time.

    ``stiffness``, ``viscosity`` and ``inertia`` are means over the realizations that it was identified from. A
    prediction uses the impedance at the time of each realization.

    Parameters
    ----------
    kernel
        Features of time that the coefficients multiply.
    phase
        Phase in s at which all realizations that it was identified from begin; NaN if they begin at different ones.
    lag
        Time constant in s of the lag that the torque has behind what the joint does.
    """

    kernel: Kernel
    phase: float
    lag: float = 0.0

    def impedance(self, ensemble: Ensemble) -> tuple[Array, Array, Array]:
        """Stiffness, viscosity and inertia at the ensemble's own times, (time,) or (realization, time)."""
        if self.same_for_all(ensemble):
            return super().impedance(ensemble)
        clocks = clocks_of(ensemble)
        values = np.stack(
            [self.kernel.combined(*times_of(ensemble, r, clocks), self.coefficients) for r in range(len(ensemble))]
        )
        stiffness, viscosity, inertia = np.moveaxis(with_zeros(values), -1, 0)
        return stiffness, viscosity, inertia

    def same_for_all(self, ensemble: Ensemble) -> bool:
        """Whether all realizations have the impedance of those that the model was identified from."""
        return self.kernel.decay is None and common_phase(ensemble, self.kernel.period) == self.phase

    def torque(self, ensemble: Ensemble) -> Array:
        """Torque for an angle that has passed the lag already, shape (realization, time)."""
        return super()._pathways(ensemble)["intrinsic"]

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        return {"intrinsic": self.torque(lagged(ensemble, self.lag))}


def with_zeros(impedance: Array) -> Array:
    """Stiffness, viscosity and inertia (..., 3), of which the last ones may be none."""
    return np.pad(impedance, [(0, 0)] * (impedance.ndim - 1) + [(0, 3 - impedance.shape[-1])])


def common_phase(ensemble: Ensemble, period: float) -> float:
    """Phase in s at which every realization begins; NaN if they begin at different ones."""
    assert ensemble.onsets is not None
    phases = np.round(ensemble.onsets % period, 9) % period
    return float(phases[0]) if np.ptp(phases) < 1e-9 else math.nan


def mean_features(ensemble: Ensemble, kernel: Kernel) -> Array:
    """Features of a kernel over a realization, averaged over realizations, shape (time, column)."""
    same = kernel.decay is None and not math.isnan(common_phase(ensemble, kernel.period))
    clocks, distinct = clocks_of(ensemble), 1 if same else len(ensemble)
    total = np.zeros((ensemble.samples, kernel.columns))
    for realization in range(distinct):
        total += kernel(*times_of(ensemble, realization, clocks))
    return total / distinct
