r"""Low-rank form of the locally periodic kernel, the prior of how stiffness changes.

.. math:: K(t, t') = \gamma \exp\left(-\frac{\sin^2(\pi (t - t') / p)}{l_1}\right)
          \exp\left(-\frac{(t - t')^2}{l_2^2}\right)

(equation 17 of van de Ruit et al. 2021). A function with this covariance is a sum of a few known
features with independent coefficients, so that no matrix of the record's length is ever built.

To use another periodic kernel, change :func:`log_harmonic_variances`, the number of harmonics in
:func:`harmonic_variances`, and ``search.LENGTHS``, the range of its length. To use another decay,
change :func:`decay`, the number of nodes in :func:`decay_features`, and ``search.DECAYS``.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from tvsysid.errors import InputError
from tvsysid.signals import Array, Ensemble

ENDLESS = 120_000.0  # s, the paper's decay for its simulations: in effect no decay
MAX_DECAY = 20.0  # in record lengths; a longer decay counts as none
# Share of the prior variance below which a feature is left out. It is so small because gamma is a
# very wide prior for inertia: 1e-9 would change stiffness by 1 N·m/rad.
TOLERANCE = 1e-13
# Maximum of harmonics * (1 + record length / l2). More would need 2 GiB of covariance.
MAX_SIZE = 1875


@attrs.frozen(eq=False)
class Kernel:
    """Features of the locally periodic kernel: harmonics of the period times slow functions.

    Each column is a cosine or sine times a slow function. ``harmonic`` is the number of its
    harmonic, ``wave`` the index of the cosine or sine in :meth:`periodic_features`, ``slow`` the
    index of the slow function, and ``precision`` the prior precision for gamma = 1. All have shape
    (column,). The first column is the constant, whose prior precision is 0. The record lasts
    ``span`` s.

    Slow function 0 is constant. A strictly periodic kernel has no others. With a decay ``l2``, only
    the first column has function 0. The others have the eigenfunctions of the decay: its values
    :func:`decay` between a time and the ``nodes``, times a matrix ``projection`` (node, function).
    """

    period: float
    span: float
    l2: float
    nodes: Array
    projection: Array
    harmonic: NDArray[np.int64]
    wave: NDArray[np.int64]
    slow: NDArray[np.int64]
    precision: Array

    @classmethod
    def of(cls, ensemble: Ensemble, l1: float, l2: float) -> Kernel:
        """Choose the features that matter over an ensemble's record.

        The period is the duration of a realization.
        """
        clocks, period = clocks_of(ensemble), ensemble.duration
        span = float(np.ptp(clocks)) + period
        # Harmonics beyond the Nyquist frequency would be aliases of slower ones.
        variances = harmonic_variances(l1)[: max(1, math.ceil(ensemble.samples / 2))]
        if len(variances) * (1 + span / l2) > MAX_SIZE:
            raise InputError(
                f"KernelRegression: a length_periodic of {l1:g} and a length_decay of {l2:g} s "
                f"over a record of {span:g} s need too many features of each coefficient; give "
                "fewer realizations, a longer length_decay or a larger length_periodic"
            )
        # Shares of the slow functions in the kernel's variance; without a decay there is one.
        nodes, projection, shares = np.zeros(0), np.zeros((0, 0)), np.ones(1)
        if l2 < MAX_DECAY * span:
            nodes, projection, shares = decay_features(float(clocks.min()), span, l2)
            shares = np.insert(shares, 0, 0.0)
        kept = np.outer(variances, shares) > TOLERANCE
        kept[0, 0] = True  # the constant, which is no part of the kernel: its prior is flat
        harmonics = np.arange(1, 2 * len(variances)) // 2  # a cosine and a sine of each but 0
        wave, slow = np.nonzero(kept[harmonics])
        harmonic = harmonics[wave]
        # Each slow function is already multiplied by its standard deviation.
        precision = np.where(harmonic + slow > 0, 1 / variances[harmonic], 0.0)
        return cls(period, span, l2, nodes, projection, harmonic, wave, slow, precision)

    @property
    def column_count(self) -> int:
        """Return the number of columns of each quantity."""
        return len(self.precision)

    @property
    def functions(self) -> int:
        """Return the number of slow functions."""
        return 1 + int(self.projection.shape[1])

    @property
    def highest(self) -> int:
        """Return the highest harmonic of the period."""
        return int(self.harmonic[-1])

    def periodic_features(self, phase: Array) -> Array:
        """Return a constant, and cosine and sine of each harmonic, shape (*phase, function)."""
        turn = np.exp(2j * np.pi / self.period * phase)[..., None]
        # Powers of one turn, whose parts are the cosines and sines.
        powers = np.cumprod(np.broadcast_to(turn, (*phase.shape, self.highest)), axis=-1)
        return np.concatenate([np.ones((*phase.shape, 1)), powers.view(np.float64)], axis=-1)

    def slow_features(self, clock: Array) -> Array:
        """Return a constant and the slow functions at times in s, shape (*clock, function)."""
        functions = decay(clock, self.nodes, self.l2) @ self.projection
        return np.concatenate([np.ones((*clock.shape, 1)), functions], axis=-1)

    def means(self, phase: Array, clock: Array) -> Array:
        """Return the mean over realizations of all columns, shape (time, column).

        ``phase`` is the time within the period, ``clock`` that of the record, both in s and of
        shape (realization, time), or (1, time) if it is the same for all.
        """
        periodic, slow = self.periodic_features(phase), self.slow_features(clock)
        products = np.einsum("rtw,rts->wst", periodic, slow) / max(len(phase), len(clock))
        return products[self.wave, self.slow].T

    def sums(self, phase: Array, clock: Array, coefficients: Array) -> Array:
        """Return columns times ``coefficients`` (quantity, column), (*time, quantity)."""
        weights = np.zeros((2 * self.highest + 1, len(coefficients), self.functions))
        weights[self.wave, :, self.slow] = coefficients.T
        of_slow = np.tensordot(self.periodic_features(phase), weights, 1)
        return np.einsum("...qj,...j->...q", of_slow, self.slow_features(clock))


def clocks_of(ensemble: Ensemble) -> Array:
    """Return the onset in s of each realization on one clock, with trials one after another."""
    span = float(np.ptp(ensemble.onsets)) + ensemble.duration
    _, number = np.unique(ensemble.trials, return_inverse=True)
    return ensemble.onsets + number * span


def log_harmonic_variances(l1: float, harmonics: int) -> tuple[Array, Array]:
    r"""Return the log variances of a constant and some harmonics, and their derivatives by log l1.

    With :math:`\kappa = 1 / (2 l_1)`,

    .. math:: e^{-\sin^2(\pi\Delta/p)/l_1} = e^{-\kappa} e^{\kappa\cos(2\pi\Delta/p)}
              = \sum_h v_h \cos(2\pi h\Delta/p), \quad v_0 = e^{-\kappa} I_0(\kappa),\
              v_h = 2 e^{-\kappa} I_h(\kappa)

    Both have shape (harmonic,). They are minus infinity and 0 where a variance underflows.
    """
    # Kernels of a larger kappa hardly differ, and SciPy has no Bessel functions of it.
    kappa = min(1 / (2 * l1), 1e9)
    orders = np.arange(harmonics + 1)
    own = ive(orders, kappa)
    is_known = own > np.finfo(float).tiny
    safe = np.where(is_known, own, 1.0)
    neighbours = 0.5 * (ive(np.abs(orders - 1), kappa) + ive(orders + 1, kappa))
    logs = np.where(is_known, np.log(safe) + np.log(np.where(orders == 0, 1.0, 2.0)), -np.inf)
    return logs, np.where(is_known, -kappa * (neighbours / safe - 1), 0.0)


def harmonic_variances(l1: float) -> Array:
    """Return the variances of a constant and the harmonics that matter. Their sum is 1."""
    count = math.ceil(min(10 + 8 * math.sqrt(1 / (2 * l1)), 2 * MAX_SIZE))
    variances = np.exp(log_harmonic_variances(l1, count)[0])
    return variances[: int(np.flatnonzero(variances > TOLERANCE)[-1]) + 1]


def decay_features(first: float, span: float, l2: float) -> tuple[Array, Array, Array]:
    """Return nodes, projection and mean squares of functions f that represent the decay.

    The decay from t to t' is the sum of f(t) f(t') over the functions. The functions are the
    eigenfunctions of :func:`decay` over a span in s, times their standard deviations, largest
    first. They are calculated on Gauss-Legendre nodes and extended to any time by the covariance
    itself (Nyström).
    """
    nodes, weights = np.polynomial.legendre.leggauss(math.ceil(16 + 5 * span / l2))
    nodes = first + span * (nodes + 1) / 2
    root = np.sqrt(weights / 2)
    values, vectors = np.linalg.eigh(root[:, None] * decay(nodes, nodes, l2) * root)
    kept = values > TOLERANCE * values.sum()
    projection = root[:, None] * vectors[:, kept] / np.sqrt(values[kept])
    return nodes, np.ascontiguousarray(projection[:, ::-1]), values[kept][::-1]


def decay(time: Array, other: Array, l2: float) -> Array:
    r"""Return the decay :math:`e^{-(t - t')^2 / l_2^2}`, shape (*time, other time)."""
    return np.exp(-(((time[..., None] - other) / l2) ** 2))
