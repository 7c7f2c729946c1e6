r"""Low-rank forms of the locally periodic kernel.

.. math:: K(t, t') = \gamma \exp\left(-\frac{\sin^2(\pi (t - t') / p)}{l_1}\right)
          \exp\left(-\frac{(t - t')^2}{l_2^2}\right)

(equation 17 of van de Ruit et al. 2021). A function with this covariance is a sum of a few known features with
independent coefficients, so that no matrix of the record's length is ever built.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ive

from tvsysid.numerics import Array

# Share of the prior variance below which a feature is left out. Small, because a prior that suits stiffness is immense
# for inertia: at 1e-9, what is left out changes stiffness by 1 N·m/rad.
TOLERANCE = 1e-13


def harmonic_variances(l1: float) -> Array:
    r"""Variances of the harmonics in the periodic factor, from the constant to the last that matters; their sum is 1.

    With :math:`\kappa = 1 / (2 l_1)`,

    .. math:: e^{-\sin^2(\pi\Delta/p)/l_1} = e^{-\kappa} e^{\kappa\cos(2\pi\Delta/p)}
              = \sum_h v_h \cos(2\pi h\Delta/p), \quad v_0 = e^{-\kappa} I_0(\kappa),\ v_h = 2 e^{-\kappa} I_h(\kappa)
    """
    kappa = 1 / (2 * l1)
    orders = np.arange(math.ceil(10 + 8 * math.sqrt(kappa)) + 1)
    variances = np.where(orders == 0, 1.0, 2.0) * ive(orders, kappa)
    return np.asarray(variances[: int(np.flatnonzero(variances > TOLERANCE)[-1]) + 1])


def log_harmonic_variances(l1: float, harmonics: int) -> tuple[Array, Array]:
    """Logs of :func:`harmonic_variances` up to a harmonic, and their derivatives by log l1; shape (harmonic,) each.

    Minus infinity and 0 where a variance is smaller than any number.
    """
    kappa = 1 / (2 * l1)
    orders = np.arange(harmonics + 1)
    here = ive(orders, kappa)
    there = here > np.finfo(float).tiny
    safe = np.where(there, here, 1.0)
    neighbours = 0.5 * (ive(np.abs(orders - 1), kappa) + ive(orders + 1, kappa))
    logs = np.where(there, np.log(safe) + np.log(np.where(orders == 0, 1.0, 2.0)), -np.inf)
    return logs, np.where(there, -kappa * (neighbours / safe - 1), 0.0)


def harmonic_features(time: Array, period: float, harmonics: int) -> Array:
    """Constant, then cosine and sine of each harmonic; shape (time, 2 x harmonics + 1)."""
    phase = 2 * np.pi / period * np.outer(time, np.arange(1, harmonics + 1))
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(time), -1)
    return np.concatenate([np.ones((len(time), 1)), waves], axis=1)


class DecayFeatures:
    """Features whose products make :math:`e^{-(t - t')^2 / l_2^2}` from ``first`` to ``last``, in s.

    They are the kernel's eigenfunctions over the interval, found on Gauss-Legendre nodes and continued to any time by
    the kernel itself (Nyström): ``features(t) @ features(s).T`` is the kernel.
    """

    def __init__(self, first: float, last: float, l2: float) -> None:
        self.l2 = l2
        span = max(last - first, 1e-9)
        nodes, weights = np.polynomial.legendre.leggauss(math.ceil(16 + 5 * span / l2))
        self.nodes = first + span * (nodes + 1) / 2
        root = np.sqrt(weights / 2)
        values, vectors = np.linalg.eigh(root[:, None] * self._kernel(self.nodes) * root)
        kept = values > TOLERANCE * values.sum()
        self.variances: Array = values[kept][::-1]
        self.projection: Array = (root[:, None] * vectors[:, kept] / np.sqrt(values[kept]))[:, ::-1]

    def _kernel(self, time: Array) -> Array:
        return np.asarray(np.exp(-(((time[:, None] - self.nodes) / self.l2) ** 2)))

    def __call__(self, time: Array) -> Array:
        """Values at the times in s, shape (time, feature)."""
        return self._kernel(time) @ self.projection
