"""Structural decomposition by subspaces (SDSS)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.dataset_layout import UNITS
from tvsysid.errors import InputError
from tvsysid.methods.base import Method, fitting_lags, missing_edge, whole_samples
from tvsysid.methods.cascade.pathways import (
    PATHWAYS,
    TwoPathwayModel,
    of_unit_slope,
    velocity_terms,
)
from tvsysid.methods.shared.estimates import impedance_estimates, standard_errors
from tvsysid.models import Diagnostics, Estimate, StandardError
from tvsysid.numerics.noise import autocovariance
from tvsysid.numerics.second_order import agreement, second_order_readout
from tvsysid.numerics.subspace import (
    ROUNDING,
    Hammerstein,
    Piece,
    Rows,
    dynamics,
    hammerstein,
    project,
    rows_of,
    weights_of,
)
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import at_least, optional, positive

MAX_HORIZON = 60  # samples; beyond, the Hankel matrices have thousands of columns
STEPS = 4  # fits in the time of one window
MEMORY_S = 0.6  # maximum duration of a reflex response
FORGOTTEN = 0.01  # share of a reflex response's area that is cut off its end
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
        Poles of the reflex's linear part.
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
    horizons. Windows move by a quarter of their length; results are interpolated in between.

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
    order: int = attrs.field(default=2, validator=at_least(1))
    horizon: float = attrs.field(default=0.2, validator=positive)
    window: float | None = attrs.field(default=None, validator=optional(positive))

    key = "sdss"
    uses_recorded_angle = True
    quantities = ("reflex_gain",)
    pathway_names = PATHWAYS
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
        """Return a reason to skip if the Hankel matrices would be too short or too large."""
        rate, depth = ensemble.sampling_rate, whole_samples(self.horizon, ensemble)
        if not self.order < depth <= MAX_HORIZON:
            return (
                f"its horizon of {self.horizon:g} s has {depth} samples at {rate:g} Hz; expected "
                f"more than the {self.order} of the order and {MAX_HORIZON} at most; change the "
                "horizon, or decimate to some 100 Hz"
            )
        lags = whole_samples(self.delay, ensemble)
        edges = 2 * missing_edge(lags, ensemble)
        lengths = [len(run) * ensemble.samples - edges for run in ensemble.runs]
        rows = sum(length - 2 * depth + 1 for length in lengths if length >= 2 * depth)
        needed = (2 * self.terms + 2 * lags + 1) * depth + 1
        if rows > needed:
            return None
        return (
            f"it needs stretches of record longer than two horizons ({2 * self.horizon:g} s), "
            f"with {needed / rate:.3g} s together beyond that; got {len(lengths)} of up to "
            f"{max(lengths) / rate:.3g} s, with {rows / rate:.3g} s; give longer or more "
            "realizations, fewer terms or a shorter horizon"
        )

    def fit(self, ensemble: Ensemble) -> TwoPathwayModel:
        """Return the model of an ensemble."""
        lags = fitting_lags(type(self).__name__, self.delay, ensemble)
        depth, rate = whole_samples(self.horizon, ensemble), ensemble.sampling_rate
        lines = list(self._lines(ensemble, lags))
        pieces = [each for each in map(Line.core, lines) if len(each.output) >= 2 * depth]
        all_poles = dynamics(pieces, depth, self.order)
        rows = Rows.joined(rows_of(piece, all_poles) for piece in pieces)
        left = project(rows)
        rest = [piece.without(left.response) for piece in pieces]
        poles = dynamics(rest, depth, self.order, lagged=False)
        later = Rows.joined(rows_of(piece, poles) for piece in pieces)
        sizes = [len(piece.output) for piece in pieces]
        whole = fit(rows, left, later, poles, sizes, rate)
        if self.window is None:
            return self._model(ensemble, [0], [whole])
        half = whole_samples(self.window, ensemble) // 2
        count = max(2, 1 + round((ensemble.samples - 1) / max(1, 2 * half // STEPS)))
        centres = np.linspace(0, ensemble.samples - 1, count).round().astype(int).tolist()
        fits = self._windows(lines, all_poles, whole.reflex, centres, half, rate)
        return self._model(ensemble, centres, list(fits))

    def _lines(self, ensemble: Ensemble, lags: int) -> Iterator[Line]:
        """Yield realizations that follow each other, with the context about them."""
        core, context = ensemble.core, ensemble.context
        signals = np.stack([ensemble.torque, ensemble.angle])
        terms = velocity_terms(ensemble, self.terms)
        # A mean that is subtracted at each time is subtracted from all, and an offset is one.
        if not ensemble.mean_subtracted:
            signals -= signals.mean(axis=(1, 2), keepdims=True)
        terms -= terms.mean(axis=1 if ensemble.mean_subtracted else (1, 2), keepdims=True)
        signals = np.concatenate([signals, terms])
        for run in ensemble.runs:
            ends = signals[:, run[0], :context], signals[:, run[-1], core.stop :]
            cores = signals[:, run, core].reshape(len(signals), -1)
            torque, angle, *inputs = np.concatenate([ends[0], cores, ends[1]], axis=1)
            piece = Piece(torque[lags:-lags], angle, np.stack(inputs, axis=1)[: -2 * lags])
            yield Line(
                piece, context - lags + ensemble.samples * np.arange(len(run)), ensemble.samples
            )

    def _windows(
        self,
        lines: Sequence[Line],
        all_poles: Array,
        reflex: Hammerstein,
        centres: Sequence[int],
        half: int,
        rate: float,
    ) -> Iterator[Fit]:
        """Yield the fits of windows that reach ``half`` samples to either side of the centres.

        The poles and the reflex are those of all data.
        """
        poles = reflex.denominator
        pairs = [[rows_of(line.piece, each) for each in (all_poles, poles)] for line in lines]
        needed = 2 * self.terms * (1 + self.order)  # twice the answers
        for centre in centres:
            windows = [
                (pair, window)
                for pair, line in zip(pairs, lines, strict=True)
                for window in line.windows(centre, half)
            ]
            sizes = [window.stop - window.start for _, window in windows]
            if sum(sizes) < needed:
                raise InputError(
                    f"SubspaceCascade: a window of {self.window:g} s holds {sum(sizes)} samples of "
                    f"all realizations, it needs {needed}; give a longer window, more realizations "
                    "or fewer terms"
                )
            rows, later = (
                Rows.joined(pair[place].within(window) for pair, window in windows)
                for place in (0, 1)
            )
            yield fit(rows, project(rows), later, poles, sizes, rate, reflex.weights)

    def _model(
        self, ensemble: Ensemble, centres: Sequence[int], fits: Sequence[Fit]
    ) -> TwoPathwayModel:
        """Return the model of fits at some samples, interpolated in between."""
        lags, rate = whole_samples(self.delay, ensemble), ensemble.sampling_rate
        edge, longest = missing_edge(lags, ensemble), whole_samples(MEMORY_S, ensemble)
        reflexes, times = [each.reflex for each in fits], np.arange(ensemble.samples)
        lasts = max(lasting(each.impulse_response(longest)) for each in reflexes)
        drive, slope = of_unit_slope(ensemble, reflexes[0].weights)

        def over_time(values: Sequence[Array], missing: int = 0) -> Array:
            columns = np.transpose(values)
            out = np.stack([np.interp(times, centres, each) for each in columns], axis=1)
            out[(times < missing) | (times >= len(times) - missing)] = np.nan
            return out

        impedance, errors, response = (
            over_time([getattr(each, name) for each in fits], edge)
            for name in ("impedance", "errors", "response")
        )
        arcs = [np.inf if self.window else 0.0] * 3
        bands = standard_errors(errors, min(each.freedom for each in fits), arcs)
        gain = slope * over_time([np.array([each.static_gain]) for each in reflexes])[:, 0]
        no_band = StandardError.none(len(gain), NO_BAND)
        estimates = impedance_estimates(impedance, bands)
        estimates["reflex_gain"] = Estimate(gain, UNITS["reflex_gain"], error=no_band)
        reflex = over_time([each.impulse_response(lasts) for each in reflexes])
        agrees = agreement(*np.stack([each.powers for each in fits], axis=1))
        return TwoPathwayModel(
            method=repr(self),
            sampling_rate=rate,
            time=ensemble.time,
            estimates=estimates,
            impulse_response=response,
            lags=np.arange(-lags, lags + 1) / rate,
            reflex_response=slope * rate * reflex,
            reflex_lags=(lags + np.arange(lasts)) / rate,
            drive=drive,
            diagnostics=Diagnostics(
                float(2 * lags + 1 + self.terms + 2 * self.order),
                details={"second_order_agreement": agrees},
            ),
        ).with_shares(ensemble)


class Line(NamedTuple):
    """Realizations that follow each other, with the context about them, as one ``piece``.

    Realizations of ``samples`` samples begin at the ``onsets``. The first is below 0 where lags
    reach beyond the context.
    """

    piece: Piece
    onsets: NDArray[np.int64]
    samples: int

    def core(self) -> Piece:
        """Return the realizations without context, as far as lags reach."""
        output, lagged, inputs = self.piece
        first, last = max(0, self.onsets[0]), min(len(output), self.onsets[-1] + self.samples)
        lagged = lagged[first : last + len(lagged) - len(output)]
        return Piece(output[first:last], lagged, inputs[first:last])

    def windows(self, centre: int, half: int) -> list[slice]:
        """Return the window of samples about ``centre`` in each realization."""
        firsts = (self.onsets + centre - half).clip(0).tolist()
        lasts = (self.onsets + centre + half + 1).clip(max=len(self.piece.output)).tolist()
        return [slice(*pair) for pair in zip(firsts, lasts, strict=True) if pair[0] < pair[1]]


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
    reflex: Hammerstein


def fit(
    rows: Rows,
    left: Rows,
    later: Rows,
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
    weights = weights_of(rest, order) if weights is None else weights
    reflex = hammerstein(rest, poles, weights)
    moments, own = (np.asarray(each.T @ each / count) for each in (rows.signals, left.signals))
    inverse, own = (
        np.asarray(np.linalg.pinv(each, ROUNDING, hermitian=True)) for each in (moments, own)
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


def lasting(response: Array) -> int:
    """Return the number of samples after which a response has nearly ended."""
    area = np.cumsum(np.abs(response))
    return 1 + int(np.searchsorted(area, (1 - FORGOTTEN) * area[-1]))
