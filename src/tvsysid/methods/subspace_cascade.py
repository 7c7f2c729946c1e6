"""Structural decomposition by subspaces (SDSS)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import attrs
import numpy as np

from tvsysid.dataset_layout import UNITS
from tvsysid.errors import InputError
from tvsysid.methods.base import (
    Method,
    fitting_lags,
    missing_edge,
    padded,
    whole_samples,
)
from tvsysid.methods.cascade.pathways import (
    Drive,
    TwoPathwayModel,
    of_unit_slope,
    velocity_terms,
)
from tvsysid.methods.shared.estimates import impedance_estimates, standard_errors
from tvsysid.methods.subspace_windows import Line, grid, lasting
from tvsysid.models import Diagnostics, Estimate, StandardError
from tvsysid.numerics import subspace
from tvsysid.numerics.noise import autocovariance
from tvsysid.numerics.second_order import agreement, second_order_readout
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import at_least, optional, positive

MAX_HORIZON = 60  # samples; beyond, the Hankel matrices have thousands of columns
STEPS = 4  # fits in the time of one window
MEMORY_S = 0.6  # maximum duration of a reflex response
NO_BAND = "numerator and nonlinearity take turns; a bootstrap gives their spread"
MAX_COLOUR_S = 0.6  # lag up to which the noise's autocorrelation counts


@attrs.frozen
class SubspaceCascade(Method):
    r"""Separate intrinsic and reflex stiffness by projection and subspace identification.

    .. math:: y(t) = \sum_{|\tau| \le d} h(\tau)\, \theta(t - \tau)\, \Delta t
                     + \sum_{\tau \ge 0} p(\tau)\, f(t - d - \tau)\, \Delta t, \qquad
              f = \sum_j \omega_j T_j(\dot\theta)

    The reflex answers after the delay d, and only then; the intrinsic response is no longer than
    that. The reflex is a static nonlinearity of the velocity, a sum of Chebyshev polynomials,
    before a linear system of low order. MOESP with past inputs gives this system's poles. The
    intrinsic response is that of the torque to the lagged angles after all that a system with these
    poles could do is taken out. Numerator and polynomial are fitted to its residual.

    Parameters
    ----------
    delay
        Of the reflex in s: 40 ms for plantarflexors, 50 ms for dorsiflexors.
    terms
        Polynomials of the velocity, of degree 1 on.
    order
        Poles of the reflex's linear part; None takes as many as the largest gap of the singular
        values says.
    horizon
        Length of the Hankel matrices in s.
    window
        None takes the joint as constant. In s, intrinsic response and reflex gain are those of a
        window about each time, from all realizations; the reflex's poles and its nonlinearity are
        those of all data.

    Notes
    -----
    Realizations that follow each other are one record. Others are short segments of one behaviour.
    The state in which each segment begins is estimated too, and segments must be longer than two
    horizons. Windows move by a quarter of their length; results are interpolated in between. A
    window takes only samples before which the velocity is known as long as the poles last.

    Directions of the inputs are counted as far as they are beyond rounding. Poles outside the unit
    circle are reflected into it. A reflex that is not there has poles all the same: those of the
    noise.

    Stiffness is the area under the intrinsic response; viscosity and inertia are those of a
    second-order fit to it, as in :class:`EnsembleIRF`. With so few lags inertia comes out 5 % too
    large where a PRBS moves the joint.

    The ``reflex_gain``, in N·m·s/rad, is the slope of the nonlinearity for stretch times the area
    under the reflex response. The slope is that of the least-squares fit of two straight lines,
    over the measured velocities, in the direction in which it is steeper. The nonlinearity
    is scaled so that it is 1; at rest it is 0. A gain that changes appears with its torque, some
    0.1 s after the stretch. A torque's offset belongs to no pathway.

    The bands of stiffness, viscosity and inertia are those of the projection's least squares, with
    noise of the residual's colour. They take the poles as known: 95 % bands of stiffness held the
    truth in 87 to 90 % of simulated records of 60 s. The reflex gain comes from an alternation and
    has none; :func:`tvsysid.uncertainty.bootstrap` gives its spread over realizations.

    References
    ----------
    Jalaleddini, Sobhani Tehrani & Kearney 2017, A subspace approach to the structural decomposition
    and identification of ankle joint dynamic stiffness, IEEE Trans. Biomed. Eng. (whole records);
    Jalaleddini, Golkar & Kearney 2017, Measurement of dynamic joint stiffness from multiple short
    data segments, IEEE Trans. Neural Syst. Rehabil. Eng.
    """

    delay: float = attrs.field(default=0.04, validator=positive)
    terms: int = attrs.field(default=11, validator=at_least(1))
    order: int | None = attrs.field(default=2, validator=optional(at_least(1)))
    horizon: float = attrs.field(default=0.2, validator=positive)
    window: float | None = attrs.field(default=None, validator=optional(positive))

    key = "sdss"
    uses_recorded_angle = True
    quantities = ("reflex_gain",)
    pathway_names = ("intrinsic", "reflex")
    title = "Structural decomposition by subspaces (SDSS)"
    assumptions = (
        "Two pathways: an intrinsic one that answers within the delay, and a reflex to velocity "
        "that answers after it.",
        "The reflex is a static nonlinearity before a linear system of low order.",
        "The joint does not change, or changes little within the window.",
    )
    differs = (
        "It is one constant, or a mean over its window, some mean where the joint changes faster."
    )
    cites = ("jalaleddini2017", "jalaleddini2017segments")

    @property
    def time_invariant(self) -> bool:  # type: ignore[override]
        """Return whether the method takes the joint as constant."""
        return self.window is None

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return a reason to skip if horizon or window do not fit the ensemble.

        The Hankel matrices may be too short or too large, or a window may hold too few samples.
        """
        rate, depth = ensemble.sampling_rate, whole_samples(self.horizon, ensemble)
        if not (self.order or 1) < depth <= MAX_HORIZON:
            return (
                f"its horizon of {self.horizon:g} s has {depth} samples at {rate:g} Hz; expected "
                f"more than the {self.order or 1} of the order and {MAX_HORIZON} at most; "
                "change the horizon, or decimate to some 100 Hz"
            )
        edges = 2 * missing_edge(whole_samples(self.delay, ensemble), ensemble)
        lengths = [len(run) * ensemble.samples - edges for run in ensemble.runs]
        rows = sum(length - 2 * depth + 1 for length in lengths if length >= 2 * depth)
        needed = (2 * self.terms + 2 * whole_samples(self.delay, ensemble) + 1) * depth + 1
        if rows <= needed:
            return (
                f"it needs stretches of record longer than two horizons ({2 * self.horizon:g} s), "
                f"with {needed / rate:.3g} s together beyond that; got {len(lengths)} of up to "
                f"{max(lengths) / rate:.3g} s, with {rows / rate:.3g} s; give longer or more "
                "realizations, fewer terms or a shorter horizon"
            )
        held = len(ensemble) * whole_samples(self.window or ensemble.duration, ensemble)
        if held < self._min_samples():
            return (
                f"a window of {self.window:g} s holds {held} samples of {len(ensemble)} "
                f"realizations, it needs {self._min_samples()}; give a longer window, more "
                "realizations or fewer terms"
            )
        return None

    def _min_samples(self) -> int:
        """Return the number of samples that a window must hold.

        It is twice the number of basis systems of the reflex: each term times each state or input.
        """
        return 2 * self.terms * (1 + (self.order or 2))

    def fit(self, ensemble: Ensemble) -> TwoPathwayModel:
        """Return the model of an ensemble."""
        lags = fitting_lags(type(self).__name__, self.delay, ensemble)
        depth, rate = whole_samples(self.horizon, ensemble), ensemble.sampling_rate
        terms = velocity_terms(ensemble, self.terms)
        # A mean that is subtracted at each time is subtracted from all, and an offset is one.
        axis = 0 if ensemble.mean_subtracted else None
        inputs = np.stack([each - each.mean(axis=axis) for each in terms], axis=-1)
        lines = [Line.of(ensemble, inputs, run, lags) for run in ensemble.runs]
        pieces = [piece for piece in map(Line.core, lines) if len(piece.output) >= 2 * depth]
        all_poles = subspace.dynamics(pieces, depth, self.order)
        rows = _rows_of(pieces, all_poles)
        left = subspace.project(rows)
        rest = [piece.without(left.response) for piece in pieces]
        poles = subspace.dynamics(rest, depth, len(all_poles) - 1, lagged=False)
        sizes = [len(piece.output) for piece in pieces]
        whole = fit(rows, left, _rows_of(pieces, poles), poles, sizes, rate)
        fits: Sequence[Fit | None] = [whole]
        shares = np.ones((ensemble.samples, 1))
        if self.window is not None:
            fits, shares = self._fit_windows(ensemble, lines, all_poles, whole.reflex)
        drive, slope = of_unit_slope(ensemble, whole.reflex.weights)
        return self._model(ensemble, fits, shares, drive, slope).with_shares(ensemble)

    def _fit_windows(
        self,
        ensemble: Ensemble,
        lines: Sequence[Line],
        all_poles: Array,
        reflex: subspace.Hammerstein,
    ) -> tuple[Sequence[Fit | None], Array]:
        """Return the fits in windows, and the share (time, fit) of each fit at each time.

        A fit is None where too few samples are known. Poles and weights are those of all data.
        """
        half = whole_samples(self.window or 0.0, ensemble) // 2
        centres, shares = grid(ensemble.samples, max(1, 2 * half // STEPS))
        longest, systems = whole_samples(MEMORY_S, ensemble), (all_poles, reflex.denominator)
        past = max(lasting(subspace.impulse_response([1.0], each, longest)) for each in systems)
        whole = [
            [subspace.rows_of(line.piece, each, free=False) for line in lines] for each in systems
        ]
        fits: list[Fit | None] = []
        for centre in centres:
            windows = [
                (place, window)
                for place, line in enumerate(lines)
                for window in line.windows(centre, half, past)
            ]
            sizes = [window.stop - window.start for _, window in windows]
            if sum(sizes) < self._min_samples():
                fits.append(None)
                continue
            rows, later = (
                subspace.joined(each[place].chosen(window) for place, window in windows)
                for each in whole
            )
            left, rate = subspace.project(rows), ensemble.sampling_rate
            fits.append(fit(rows, left, later, reflex.denominator, sizes, rate, reflex.weights))
        return fits, shares

    def _model(
        self,
        ensemble: Ensemble,
        fits: Sequence[Fit | None],
        shares: Array,
        drive: Drive,
        slope: float,
    ) -> TwoPathwayModel:
        """Return the model of fits and of their ``shares`` (time, fit) at each time.

        The drive was divided by ``slope``.
        """
        known = [each for each in fits if each is not None]
        if not known:
            raise InputError(
                "SubspaceCascade: in no window the velocity is known as long before as the reflex "
                f"lasts, some {MEMORY_S:g} s; give realizations that follow each other, more "
                "context, or window=None"
            )
        lags, rate = whole_samples(self.delay, ensemble), ensemble.sampling_rate
        edge, longest = missing_edge(lags, ensemble), whole_samples(MEMORY_S, ensemble)
        lasts = max(lasting(each.reflex.impulse_response(longest)) for each in known)

        def over_time(values: Sequence[Array], missing: int = 0) -> Array:
            table = np.full((len(fits), len(values[0])), np.nan)
            table[[each is not None for each in fits]] = values
            # A fit without a share at a time does not count there, even if it is NaN
            mixed = np.where(shares[..., None] > 0, shares[..., None] * table, 0.0).sum(axis=1)
            return padded(mixed[missing : len(mixed) - missing], missing)

        impedance, errors, response = (
            over_time(each, edge)
            for each in zip(
                *((fit.impedance, fit.errors, fit.response) for fit in known), strict=True
            )
        )
        freedom = min(each.freedom for each in known)
        bands = standard_errors(errors, freedom, [np.inf if self.window else 0.0] * 3)
        gain = slope * over_time([np.array([fit.reflex.static_gain]) for fit in known])[:, 0]
        no_band = StandardError.none(len(gain), NO_BAND)
        estimates = impedance_estimates(impedance, bands)
        estimates["reflex_gain"] = Estimate(gain, UNITS["reflex_gain"], error=no_band)
        order = len(known[0].reflex.denominator) - 1
        agrees = agreement(*np.stack([each.powers for each in known], axis=1))
        return TwoPathwayModel(
            method=repr(self),
            sampling_rate=rate,
            time=ensemble.time,
            estimates=estimates,
            impulse_response=response,
            lags=np.arange(-lags, lags + 1) / rate,
            reflex_response=slope
            * rate
            * over_time([fit.reflex.impulse_response(lasts) for fit in known]),
            reflex_lags=(lags + np.arange(lasts)) / rate,
            drive=drive,
            diagnostics=Diagnostics(
                float(2 * lags + 1 + self.terms + 2 * order),
                details={"second_order_agreement": agrees, "reflex_order": float(order)},
            ),
        )


class Fit(NamedTuple):
    """Intrinsic ``response`` (lag,) in N·m/rad/s, ``impedance`` (3,) and the ``reflex``.

    ``errors`` are the standard errors of the impedance. ``powers`` are three powers of the torque:
    a second-order fit explains the first, and lagged angles explain the second beyond it. The
    third is the power that they would explain by chance.
    """

    response: Array
    powers: Array
    impedance: Array
    errors: Array
    freedom: int
    reflex: subspace.Hammerstein


def _rows_of(pieces: Sequence[subspace.Piece], poles: Array) -> subspace.Rows:
    return subspace.joined(subspace.rows_of(piece, poles) for piece in pieces)


def fit(
    rows: subspace.Rows,
    left: subspace.Rows,
    later: subspace.Rows,
    poles: Array,
    sizes: Sequence[int],
    rate: float,
    weights: Array | None = None,
) -> Fit:
    """Fit both pathways to samples in which the joint is constant.

    ``sizes`` are the numbers of samples of the pieces, which follow each other. ``left`` are the
    projected ``rows``, which give the intrinsic response. The reflex has the denominator
    ``poles``, and these ``weights`` or its own. It is fitted to the residual of the intrinsic
    response in ``later``.
    """
    response, count, order = left.response, len(left.output), len(poles) - 1
    rest = later._replace(output=later.output - later.signals @ response)
    weights = subspace.weights_of(rest, order) if weights is None else weights
    reflex = subspace.hammerstein(rest, poles, weights)
    moments, own = (np.asarray(each.T @ each / count) for each in (rows.signals, left.signals))
    inverse, own = (
        np.asarray(np.linalg.pinv(each, subspace.ROUNDING, hermitian=True))
        for each in (moments, own)
    )
    cross = moments @ response
    (readout,), (fitted,) = second_order_readout(moments[None], cross[None], inverse[None], rate)
    freedom = max(1, count - len(cross) - len(weights) - order * (2 + len(sizes)))
    answers = left.signals @ (own @ moments @ readout.T) / count
    variances = coloured_variances(answers, reflex.left, sizes, round(MAX_COLOUR_S * rate))
    errors = np.sqrt(np.maximum(variances, 0.0) * count / freedom)
    noise = float(reflex.left @ reflex.left) / freedom
    chance = noise / count * np.trace(own @ moments) * (1 - 3 / len(cross))
    powers = np.array([fitted, cross @ response - fitted, chance])
    return Fit(response * rate, powers, readout @ cross, errors, freedom, reflex)


def coloured_variances(answers: Array, noise: Array, sizes: Sequence[int], lags: int) -> Array:
    """Return the variances of sums of responses (time, quantity) times noise.

    The sums run over pieces of these ``sizes``, which follow each other.
    """
    columns = np.column_stack([noise, answers])
    pieces = np.zeros((len(sizes), max(sizes), columns.shape[1]))  # short ones end with zeros
    pieces[np.arange(max(sizes)) < np.array(sizes)[:, None]] = columns
    own, *others = (autocovariance(each, lags) * each.size for each in np.moveaxis(pieces, -1, 0))
    taper = np.r_[1.0, 2 * (1 - np.arange(1, lags + 1) / (lags + 1))]
    return np.asarray(others @ (taper * own / len(noise)))
