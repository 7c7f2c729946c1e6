"""Intrinsic and reflex pathway of a joint in one fit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import attrs

from tvsysid.errors import InputError
from tvsysid.methods import base
from tvsysid.methods.cascade import result
from tvsysid.methods.cascade.pathways import PATHWAYS
from tvsysid.methods.cascade.search import Search
from tvsysid.models import Model
from tvsysid.numerics.stretch import FAST
from tvsysid.signals import Ensemble
from tvsysid.validators import Validator, is_whole, optional, positive, text

_three_counts = Validator(
    "three whole numbers of 0 or more: of stiffness, viscosity and reflex gain",
    lambda value: len(value) == 3 and all(is_whole(each) and each >= 0 for each in value),
)
_positive_or_fit = Validator(
    "a positive number, 'fit' or None",
    lambda value: value in ("fit", None) or positive.is_valid(value),
)


def _has_known_delay(method: JointCascade, attribute: object, emg: str | None) -> None:
    if emg is not None and method.delay == "fit":
        raise InputError(
            "JointCascade: the delay from EMG to torque is not fitted; give it in s, as in "
            "delay=0.01"
        )


@attrs.frozen
class JointCascade(base.Method):
    r"""Identify both pathways in one fit: a short intrinsic response and a stretch reflex.

    The intrinsic response h is to the angle. The reflex acts through a muscle.

    .. math:: y(t) = \sum_{|\tau| \le 40\,ms} h(t, \tau)\, \theta(t - \tau)\, \Delta t + r(t) + e(t)

    .. math:: \ddot r + 2 \zeta \omega\, \dot r + \omega^2\, r = \omega^2\, G(t)\, f(t - d), \qquad
              f = s \max(s\, \dot\theta - c, 0)

    Stiffness is the sum of h. The intrinsic torque is a weighted sum of the angle, its velocity,
    its acceleration and its differences of higher order. The coefficients of the first two and the
    gain G are Fourier series of the realization. The other coefficients are constant.

    Parameters
    ----------
    harmonics
        Number of harmonics of stiffness, viscosity and reflex gain over a realization. Stiffness,
        viscosity and gain change if the changes predict held-out realizations better (p < 0.05).
        (0, 0, 0) takes them as constant.
    delay
        d in s; ``"fit"`` estimates it between 35 and 75 ms. Below the lags of the intrinsic
        response, the reflex would explain the torque of inertia. None is 40 ms, or 10 ms from EMG
        to torque.
    emg
        Channel that drives the muscle instead of the velocity, such as the envelope of the EMG.
        There is no threshold then.

    Notes
    -----
    Coefficients have Gaussian priors relative to the noise. The priors are wide for the constants
    of stiffness, viscosity and inertia, and :math:`\gamma h^{-\nu}` for the h-th harmonic. The
    differences share one size; the mean gain has its own. Sizes and decays are those of greatest
    evidence. The muscle's frequency and damping, the threshold c and a free delay are found by
    Gauss-Newton steps. Each step solves for all coefficients, because a reflex that is fitted to
    the residual of an intrinsic fit has lost part of its torque.

    Samples are weighted by the noise's inverse covariance within a realization (or 2.56 s of it at
    100 Hz), from the residual of a first fit. Without these weights, slow voluntary torque could
    look like a change of stiffness, or hide one. Where held-out realizations are then predicted
    worse (by 2 % of the squares), whitening gives weight to a misfit of the model. The noise is
    then taken as nearly white.

    The velocity is that of the total angle, rectified at the rate at which it was recorded. Torque
    and regressors are deviations from their mean over realizations. The gain is that of the stretch
    as it arrives at the muscle. Viscosity and inertia are those of a second-order fit to the
    intrinsic response from 0.5 to 15 Hz.

    A test on held-out realizations (:func:`tvsysid.methods.cascade.reflex_test.reflex_test_of`)
    decides whether there is a reflex, and in which direction of stretch s. With fewer than eight
    realizations the evidence decides. Where no reflex is shown, the model has none, and the band
    of ``reflex_gain`` says how large a gain the data allow.

    Viscosity, reflex gain and their bands are never negative. Stiffness and the gain of EMG keep
    one sign. Sizes and decays are found without this limit. A warning says so if the limit costs
    1 % of the torque.

    The threshold is 0 unless a threshold predicts held-out realizations better (p < 0.05). The
    bands count that it is not known.

    The bands count the noise's colour, the priors' pull and the uncertain shape. At jumps, which a
    Fourier series rounds off, the truth lies outside.

    The diagnostics' ``details`` hold the shape with standard errors; ``direction``;
    ``reflex_shown`` and ``constant``, 1 or 0; the explained share of the torque in per cent
    (``vaf``, ``vaf_intrinsic``, ``vaf_reflex``; the last two need not add up), and that of held-out
    torque (``vaf_held_out``, by thirds of the realizations, in turn); the log evidence without a
    reflex, with a linear late response, and with each direction; ``stiffness_fitted``, the mean
    stiffness of the second-order fit.

    References
    ----------
    The two pathways: Kearney, Stein & Parameswaran 1997, IEEE Trans. Biomed. Eng. 44, 493-504.
    The fit is our own.

    Examples
    --------
    >>> import tvsysid as tv
    >>> tv.methods.parse("cascade:delay=fit").delay
    'fit'
    """

    harmonics: tuple[int, int, int] = attrs.field(default=(25, 25, 10), validator=_three_counts)
    delay: float | Literal["fit"] | None = attrs.field(default=None, validator=_positive_or_fit)
    emg: str | None = attrs.field(default=None, validator=[optional(text), _has_known_delay])

    key = "cascade"
    title = "Joint fit of intrinsic and reflex pathways"
    assumptions = (
        "The intrinsic response lasts 40 ms to either side, the reflex comes later.",
        "The reflex answers the velocity of stretch beyond a threshold, through a muscle of second "
        "order.",
        "Behaviour is the same in all realizations, and periodic.",
    )
    differs = (
        "The torque of the reflex is taken out of the stiffness, in which methods of one pathway "
        "leave it; harmonics of the period smooth a switch."
    )
    cites = ("kearney1997",)
    quantities = ("reflex_gain",)
    pathway_names = PATHWAYS
    uses_recorded_angle = True

    @property
    def time_invariant(self) -> bool:  # type: ignore[override]
        """Return whether the settings take the joint as constant."""
        return not any(self.harmonics[:2])

    @property
    def inputs(self) -> tuple[base.Input, ...]:  # type: ignore[override]
        """Return the channel of the EMG, if it is named."""
        return () if self.emg is None else (base.Input(self.emg, "input", "V"),)

    def fit(self, ensemble: Ensemble) -> result.JointCascadeModel:
        """Return the model of an ensemble."""
        return result.model(repr(self), self.search(ensemble).select())

    def refit(self, ensemble: Ensemble, model: Model) -> Model:
        """Fit only the coefficients to a part of the realizations, if the model shows a reflex."""
        if not isinstance(model, result.JointCascadeModel):
            return self.identify(ensemble)
        if not model.diagnostics.details["reflex_shown"]:
            return self.identify(ensemble)
        return result.model(repr(self), self.search(ensemble).refit(model.hyperparameters))

    def search(self, ensemble: Ensemble) -> Search:
        """Return the reflexes that may explain the torque of an ensemble."""
        return Search(ensemble, **attrs.asdict(self))

    def _own_warnings(self, ensemble: Ensemble) -> Iterator[str]:
        rate = ensemble.sampling_rate * ensemble.angle_as_recorded.shape[-1]
        if self.emg is None and rate < FAST:
            yield (
                f"the angle is there at {rate:g} Hz only, where the velocity of fast movements "
                "cannot be rectified: the reflex's gain comes out too large, and a threshold where "
                f"there is none; give a recording at {FAST:g} Hz or more and decimate it with "
                "tvsysid.preprocess.decimate, which keeps the angle as it was"
            )
