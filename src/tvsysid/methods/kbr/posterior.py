"""What kernel-based regression knows of its coefficients, and of the impedance that they make over time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from tvsysid.estimates import StandardError
from tvsysid.methods.kbr.kernel import Kernel
from tvsysid.methods.kbr.record import Chosen, clocks_of
from tvsysid.methods.shared.residuals import PosteriorErrors
from tvsysid.numerics.gaussian import Fit, InstrumentalFit
from tvsysid.signals import Array, Ensemble

HELD = 2**13  # samples whose features are held at once


@dataclass(frozen=True, eq=False)
class KernelPosterior:
    """Posterior of all coefficients: from the ``fit`` of those ``kept``, (coefficient, column), and the prior.

    Of coefficients that the data cannot see, the prior is all that is known: its ``variances`` (coefficient,).
    """

    fit: Fit | InstrumentalFit
    kept: Chosen
    kernel: Kernel
    variances: Array

    @cached_property
    def mean(self) -> Array:
        """Of shape (coefficient,)."""
        mean = np.zeros(self.kept.size)
        mean[self.kept.ravel()] = self.fit.mean
        mean.flags.writeable = False
        return mean

    @cached_property
    def covariance(self) -> Array:
        """Of shape (coefficient, coefficient); of some megabytes, and therefore worked out when somebody asks."""
        precision = self.kernel.precision
        unseen = np.divide(1.0, precision, out=np.zeros(len(precision)), where=precision > 0)
        covariance = np.diag(0.5 * np.outer(self.variances, unseen).ravel())
        covariance[np.ix_(self.kept.ravel(), self.kept.ravel())] = self.fit.covariance
        covariance.flags.writeable = False
        return covariance

    def __getstate__(self) -> dict[str, object]:
        return {name: self.__dict__[name] for name in ("fit", "kept", "kernel", "variances")}


@dataclass(frozen=True, eq=False)
class KernelErrors:
    """Standard errors of sums of features, averaged over realizations; the features are made when somebody asks.

    ``phases`` and ``clocks`` (realization,) say when realizations whose impedance differs begin, ``time`` is that
    within one, without what is missing at its ends; ``of_noise`` makes the errors from expansions and covariances.
    """

    posterior: KernelPosterior
    phases: Array
    clocks: Array
    time: Array
    of_noise: partial[PosteriorErrors]

    def standard_errors(self) -> Mapping[str, StandardError]:
        """By quantity."""
        kernel = self.posterior.kernel
        features = np.zeros((len(self.time), kernel.columns))
        for phase, clock in zip(self.phases, self.clocks, strict=True):
            features += kernel(phase + self.time, clock + self.time) / len(self.phases)
        columns = kernel.columns
        parts = [slice(first, first + columns) for first in range(0, self.posterior.kept.size, columns)]
        covariances = tuple(self.posterior.covariance[part, part] for part in parts)
        return self.of_noise((features,) * len(parts), covariances).standard_errors()


def common_phase(ensemble: Ensemble, period: float) -> float:
    """Phase in s at which every realization begins; NaN if they begin at different ones."""
    assert ensemble.onsets is not None
    phases = np.round(ensemble.onsets % period, 9) % period
    return float(phases[0]) if np.ptp(phases) < 1e-9 else math.nan


def starts_of(ensemble: Ensemble, kernel: Kernel) -> tuple[Array, Array]:
    """Phase and time of the record in s at which realizations begin: of the first where all have one impedance."""
    assert ensemble.onsets is not None
    same = kernel.decay is None and not math.isnan(common_phase(ensemble, kernel.period))
    some = slice(0, 1) if same else slice(None)
    return ensemble.onsets[some], clocks_of(ensemble)[some]


def impedance_over(ensemble: Ensemble, kernel: Kernel, coefficients: Array) -> Array:
    """Stiffness, viscosity and inertia, shape (realization, time, 3), of realizations with an impedance of their own.

    One realization where all have the same. Of lower orders than 2, what the model does not have is 0.
    """
    starts, many = starts_of(ensemble, kernel), max(1, HELD // ensemble.samples)
    found = []
    for first in range(0, len(starts[0]), many):
        phase, clock = (np.add.outer(start[first : first + many], ensemble.time) for start in starts)
        values = kernel.combined(phase.ravel(), clock.ravel(), coefficients)
        found.append(values.reshape(*phase.shape, -1))
    impedance = np.concatenate(found)
    return np.pad(impedance, [(0, 0), (0, 0), (0, 3 - impedance.shape[2])])
