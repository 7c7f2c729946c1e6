"""Identify both pathways of a joint in turn, each from the torque that the other leaves."""

from __future__ import annotations

from typing import cast

import attrs
import numpy as np

from tvsysid.methods.base import whole_samples
from tvsysid.methods.birf import BasisIRF
from tvsysid.methods.cascade.method import TwoPathwayMethod
from tvsysid.methods.cascade.reflex_test import reflex_test_of
from tvsysid.methods.pathways import Stretch, TwoPathwayModel, driven, history
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.methods.sds import ShortDataSegments
from tvsysid.methods.shared.windows import window_means
from tvsysid.models import Estimate, StandardError
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.bases import A_BASIS, Basis, CubicBSplines, FourierSeries
from tvsysid.numerics.moments import convolve_lags
from tvsysid.numerics.pseudoinverse import truncated
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import not_negative, optional, positive, text

NO_BAND = "the method's authors state none for two pathways that are identified in turn"
MIN_REALIZATIONS = 3  # with their past: of fewer there is nothing to average over
MAX_MEMORY_SAMPLES = 250  # with twice as many, tvpc and bpc take long
MAX_TURNS = 30  # of either pathway


@attrs.frozen
class AlternatingCascade(TwoPathwayMethod):
    """Identify each pathway in turn from the torque that the other pathway leaves.

    The weights of both change by a ``basis``, unless a subclass has other ``weights``. The
    response of the reflex begins where the lags of the intrinsic response end, or at 0 with EMG or
    without ``begins_late``. Turns end when the explained torque hardly grows. The method
    ``one_pathway`` then identifies the impedance from the torque that the reflex leaves.
    Realizations whose past is not recorded are left out.
    """

    max_lag: float = attrs.field(default=0.04, validator=positive)
    memory: float = attrs.field(default=0.5, validator=positive)

    begins_late = True  # whether the reflex's response begins where the intrinsic one ends
    min_gain = 1e-5  # share of the torque's square by which a turn must improve the fit

    @property
    def basis(self) -> Basis:
        """Return the basis functions by which both responses change."""
        return FourierSeries(0)  # a constant

    @property
    def one_pathway(self) -> BasisIRF | ShortDataSegments:
        """Return the method that identifies the intrinsic pathway alone."""
        return BasisIRF(self.max_lag, self.basis, model="irf", prior="ridge")

    def weights(self, pathway: Ensemble) -> Array:
        """Return the weights (time, lag) of a pathway whose input is the angle."""
        method = BasisIRF(pathway.context / pathway.sampling_rate, self.basis, "irf", "ridge")
        _, columns, posterior = method.regression(pathway)
        return columns.weights(posterior.mean)

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return a reason to skip if too little is recorded around realizations, or too densely."""
        before, after = (whole_samples(each, ensemble) for each in (self.memory, self.max_lag))
        past = history(ensemble, ensemble.angle, before)
        count = int(np.isfinite(past).all(axis=1).sum())
        enough = count >= MIN_REALIZATIONS and ensemble.context >= after
        shortest = after + 2  # three lags of the reflex
        if enough and shortest <= before <= MAX_MEMORY_SAMPLES:
            return None
        return (
            f"{count} of {len(ensemble)} realizations have {self.memory:g} s recorded before "
            f"them, and {MIN_REALIZATIONS} are needed, with {self.max_lag:g} s after them; the "
            f"memory has {before} samples, and {shortest} to {MAX_MEMORY_SAMPLES} are needed; cut "
            "with more context (--context), change memory, or decimate to some 100 Hz"
        )

    def fit(self, ensemble: Ensemble) -> TwoPathwayModel:
        """Return the model of an ensemble."""
        rate, core = ensemble.sampling_rate, ensemble.core
        lags, last = (whole_samples(each, ensemble) for each in (self.max_lag, self.memory))
        first = lags if self.begins_late and self.emg is None else 0
        last -= (last - first) % 2  # an odd number of lags: as many before the middle as after it
        direction = reflex_test_of(ensemble).direction if self.emg is None else 1
        drive = Stretch(direction=direction, emg=self.emg)
        past = driven(ensemble, drive, last)[:, : last - first + ensemble.samples]
        known = np.isfinite(past).all(axis=1)
        past = (past - mean_known(past))[known]
        angle = ensemble.angle[known, core.start - lags : core.stop + lags]
        intrinsic, reflex = self.in_turn(angle, past, ensemble.torque[known, core], rate)
        gain = Estimate(reflex.sum(axis=1) / rate, drive.gain_unit)
        error = StandardError.none(ensemble.samples, NO_BAND)
        return TwoPathwayModel(
            sampling_rate=rate,
            time=ensemble.time,
            estimates={
                name: attrs.evolve(each, error=error)
                for name, each in {**intrinsic.estimates, "reflex_gain": gain}.items()
            },
            impulse_response=intrinsic.impulse_response,
            lags=intrinsic.lags,
            reflex_response=reflex,
            reflex_lags=(first + np.arange(reflex.shape[1])) / rate,
            drive=drive,
            diagnostics=intrinsic.diagnostics,
        ).with_details(ensemble)

    def in_turn(
        self, angle: Array, past: Array, torque: Array, rate: float
    ) -> tuple[ImpulseResponseModel, Array]:
        """Return the model of the intrinsic pathway, and the reflex's response (time, lag).

        The signals have shape (realization, time). The ``angle`` has as much context to either
        side, and the drive of the reflex as much ``past``, as their lags reach. Each is identified
        as the angle of an ensemble whose context is half its lags.
        """

        def pathway(signal: Array, left: Array) -> Ensemble:
            """Return signal and torque with as much context as the signal has."""
            context = (signal.shape[1] - left.shape[1]) // 2
            padded = np.pad(left, ((0, 0), (context, context)))
            return Ensemble(signal, padded, rate, context)

        explained, unexplained = np.zeros_like(torque), np.inf
        for _ in range(MAX_TURNS):
            intrinsic = self.weights(pathway(angle, torque - explained))
            left = torque - convolve_lags(angle, intrinsic)
            weights = self.weights(pathway(past, left))
            answer = convolve_lags(past, weights)
            share = np.sum((left - answer) ** 2) / np.sum(torque**2)
            if share > unexplained - self.min_gain:
                break
            reflex, explained, unexplained = weights, answer, share
        model = self.one_pathway.fit(pathway(angle, torque - explained))
        return cast(ImpulseResponseModel, model), reflex * rate


@attrs.frozen
class ParallelCascade(AlternatingCascade):
    r"""Identify intrinsic and reflex pathway of a joint that does not change, in turn.

    .. math:: y(t) = \Delta t \sum_{j=-n}^{n} h_j\, \theta(t - j)
              + \Delta t \sum_{i=0}^{m} p_i\, f(t - i), \qquad
              f = s \max(s\, \dot\theta, 0)

    The intrinsic response is fitted to the torque less the reflex's, then the reflex's to the
    torque less the intrinsic one, and so on until the torque explained grows by less than 0.02
    percentage points. What separates the two is that the reflex is rectified, and fitted second.

    Parameters
    ----------
    max_lag
        Lags of the intrinsic response to either side in s; no more than the reflex's delay.
    memory
        Last lag of the reflex's response in s, or one sample less. The authors' 1 s needs as much
        context, or realizations that follow each other.

    Notes
    -----
    The direction s of stretch is the one with the larger gain. ``reflex_gain`` is the
    area under the reflex's response, in N·m·s/rad.

    It is :class:`BasisCascade` with a constant instead of basis functions: each response has one
    prior, where the authors truncate it by description length. On real ankles, both give the same
    stiffness within 1 %. Where the joint changes, the model is an average. The velocity is that of
    the angle as it was recorded. The authors take the decimated velocity, which gives up to 15 %
    more stiffness where the perturbation is made of pulses. No bands are stated;
    :func:`tvsysid.uncertainty.bootstrap` gives them.

    The authors' code can also fit a polynomial of the velocity, as :class:`SubspaceCascade` does.

    References
    ----------
    Kearney, Stein & Parameswaran 1997, IEEE Trans. Biomed. Eng. 44, 493-504.
    """

    key = "pc"
    title = "Parallel cascade"
    assumptions = (
        "The joint does not change in time.",
        "The intrinsic response ends before the reflex's delay does; nothing else is assumed of "
        "either's dynamics.",
        "The reflex answers the velocity of stretch.",
    )
    differs = (
        "It is one constant, an average if the joint changes; the pathways are identified in "
        "turn, so that each may keep a part of the other's torque."
    )
    cites = ("kearney1997",)
    time_invariant = True
    begins_late = False
    min_gain = 2e-4


@attrs.frozen
class BasisCascade(AlternatingCascade):
    r"""Identify intrinsic and reflex response in turn, each as a sum of basis functions.

    .. math:: y(t) = \Delta t \sum_{\tau=-n}^{n} \sum_j
              \lambda_{\tau j} \Lambda_j(t)\, \theta(t - \tau)
              + \Delta t \sum_{\tau=d}^{m} \sum_j \mu_{\tau j} \Lambda_j(t)\, f(t - \tau)

    The intrinsic pathway is identified by :class:`BasisIRF` (``model="irf"``, ``prior="ridge"``)
    from the torque less the reflex's, the reflex with the same basis from the torque less the
    intrinsic one, and so on until the torque explained grows by less than 0.001 percentage
    points. f is the velocity of stretch, rectified, or EMG.

    Parameters
    ----------
    max_lag
        Lags of the intrinsic response to either side in s, no more than the reflex's delay. The
        reflex's response begins there; with EMG, it begins at 0.
    memory
        Last lag of the reflex's response in s, or one sample less.
    basis
        Basis functions of normalised time; see :class:`BasisIRF`.
    emg
        Rectified channel that drives the reflex instead of the velocity.

    Notes
    -----
    The direction of stretch is the one with the larger gain. ``reflex_gain`` is the
    area under the reflex's response at a time, in N·m·s/rad (with EMG, torque by the unit of EMG).
    It belongs to the time of the torque, which follows the stretch by the mean lag of the muscle.

    The authors also take slow voluntary torque out, by polynomials of time in each realization.
    ``cascade`` does without them.

    With the velocity, the papers identify a muscle of second order whose coefficients change, by
    refined instrumental variables. Here the reflex has a free response, as theirs with EMG. In
    simulations, their muscle showed no bias of the gain (here 0.75 N·m·s/rad), but five times the
    random error of the gain and 1.6 times the error of the stiffness. It explained less torque of a
    walking ankle.

    Realizations whose memory is not recorded are left out. No bands are stated: the bands of one
    pathway would not count the error of the other.

    References
    ----------
    Guarin & Kearney 2017, Front. Comput. Neurosci. 11:51, and 2018, IEEE Trans. Neural Syst.
    Rehabil. Eng. 26.
    """

    basis: Basis = attrs.field(factory=CubicBSplines, validator=A_BASIS)
    emg: str | None = attrs.field(default=None, validator=optional(text))

    key = "bpc"
    title = "Basis parallel cascade"
    assumptions = (
        "The movement is the same in all realizations.",
        "Both pathways change as sums of the basis functions chosen; faster changes are missed.",
        "The intrinsic response ends before the reflex's delay does.",
        "The reflex answers the velocity of stretch, or EMG.",
    )
    differs = (
        "It changes as its basis functions can; the pathways are identified in turn, so that each "
        "may keep a part of the other's torque."
    )
    cites = ("guarin2017", "guarin2018")


@attrs.frozen
class EnsembleCascade(AlternatingCascade):
    r"""Identify intrinsic and reflex response at each time in turn, across realizations.

    .. math:: y(t) = \Delta t \sum_{\tau=-n}^{n} h(t, \tau)\, \theta(t - \tau)
              + \Delta t \sum_{\tau=d}^{m} p(t, \tau)\, f(t - \tau)

    The intrinsic pathway is identified by :class:`ShortDataSegments` from the torque less the
    reflex's, the reflex by the same truncated pseudo-inverse from the torque less the intrinsic
    one, and so on until the torque explained grows by less than 0.001 percentage points. f is the
    velocity of stretch, rectified.

    Parameters
    ----------
    max_lag
        Lags of the intrinsic response to either side in s, no more than the reflex's delay.
        The reflex's response begins there.
    memory
        Last lag of the reflex's response in s, or one sample less.
    window
        Time in s over which the joint is taken as constant, as in :class:`ShortDataSegments`. 0, as
        the paper has it, takes each time by itself, and needs 500 to 800 realizations.

    Notes
    -----
    The direction of stretch and ``reflex_gain`` are those of :class:`BasisCascade`. The paper has a
    different static function at each time, with more coefficients than the usual number of
    realizations determines.

    Realizations that do not have the memory recorded before them are left out. No bands are stated.

    References
    ----------
    Ludvig, Starret Visser, Giesbrecht & Kearney 2011, IEEE Trans. Biomed. Eng. 58, 1715-1723.
    """

    window: float = attrs.field(default=0.10, validator=not_negative)

    key = "tvpc"
    title = "Ensemble parallel cascade"
    assumptions = (
        "The movement is the same in all realizations.",
        "The joint is constant over a short window; nothing else is assumed of how it changes.",
        "The intrinsic response ends before the reflex's delay does.",
        "Many realizations are needed: without a window, 500 to 800.",
    )
    differs = (
        "It is a mean over its window, with a large random error of few realizations; the pathways "
        "are identified in turn."
    )
    cites = ("ludvig2011",)

    @property
    def one_pathway(self) -> ShortDataSegments:
        """Return the method that identifies the intrinsic pathway alone."""
        return ShortDataSegments(self.max_lag, self.window)

    def weights(self, pathway: Ensemble) -> Array:
        """Return the weights (time, lag) of a pathway from means over the window."""
        half = whole_samples(self.window / 2, pathway)
        weights = [
            truncated(gram, cross, square, samples * len(pathway)).weights
            for samples, gram, cross, square, _ in window_means(pathway, pathway.context, half)
        ]
        return np.concatenate(weights)
