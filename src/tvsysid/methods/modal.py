"""Modal decomposition: stiffness from frequency and decay of a joint's ringing after impulses."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from tvsysid.methods import base, shared
from tvsysid.methods.birf import BasisIRF
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_and_spread, mean_of
from tvsysid.numerics.bases import FourierSeries
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import positive

MIN_PEAK = 0.25  # height of an impulse, relative to the largest torque
MIN_DISTANCE_S = 0.12  # between impulses
IMPULSIVE_POWER, MAX_TIME = 0.85, 0.1  # shares of the torque's power, and of the time it may take
MAX_DAMPING = 0.35  # damping ratio up to which a joint rings for long enough
CLEAR = 3.5  # standard deviations of the window between an impulse and the first time used
MAX_RINGING_S = 0.25  # used after each impulse
SMOOTHING_S = 0.03  # standard deviation of the Gaussian that smooths signals to find the inertia
REACH = 4.0  # standard deviations to which the window extends
ROUNDS = 3  # of the search for the frequency
HARMONICS = 6  # of stiffness and viscosity in the fit of the inertia
MIN_SAMPLES = 3  # after an impulse


@attrs.frozen
class ModalDecomposition(base.Method):
    r"""Estimate the stiffness of a lightly damped joint from its ringing after impulses.

    Frequency and decay of the ringing give

    .. math:: k = I\,(\omega^2 + s^2 + \dot s), \qquad b = 2 I s, \qquad
              s = -\frac{d \ln A}{dt} - \frac{1}{2}\frac{d \ln \omega}{dt}

    with the frequency ω (rad/s) and the amplitude A of the wave that is fitted within a Gaussian
    window about each time, beside its mirror image at -ω and a constant. Each impulse gives 0.25 s,
    from 3.5 ``window`` after it on, as far as no other impulse is near. Each time has the mean over
    the impulses that reach it. The bands are those of their spread, where two or more do, and of
    the inertia.

    Parameters
    ----------
    window
        Standard deviation of the Gaussian window in s.

    Notes
    -----
    The inertia I of all that moves is that of :class:`tvsysid.BasisIRF`, fitted to angle and torque
    after the same Gaussian has smoothed both. This removes noise and the impulses' edges.

    The method suits a joint that moves freely, or with its load, between impulses of torque. It
    suits hardly any other joint: the ankle is damped too much (damping ratio 0.6 to 1.1).
    docs/special-perturbations.md has figures. The angle is the recorded one. Its mean over
    realizations is kept, because it consists of the ringing of all realizations.

    References
    ----------
    Piovesan, Pierobon, DiZio & Lackner 2012, J. Neurosci. Methods 209, 70-83.
    """

    window: float = attrs.field(default=0.05, validator=positive)

    key = "modal"
    title = "Modal decomposition"
    assumptions = (
        "The joint is of second order, lightly damped, and free between impulses of torque.",
        "Nothing else moves it; its impedance hardly changes within a window.",
        "The movement is the same in all realizations.",
    )
    differs = (
        "It is read from how the joint rings after each impulse, and means nothing where that dies "
        "away within a cycle."
    )
    cites = ("piovesan2012",)
    perturbation = "pulses:duration=0.02,interval=1"
    system = (
        "loaded:inertia=0.1,viscosity=1.3,"
        "actuator_stiffness=0,actuator_viscosity=0,actuator_inertia=0"
    )

    def skip(self, ensemble: Ensemble) -> str | None:
        """Return a reason to skip if there are no torque impulses, or too much damping."""
        power = np.sort(ensemble.torque[:, ensemble.core].ravel() ** 2)[::-1]
        time = float(np.mean(np.cumsum(power) < IMPULSIVE_POWER * power.sum()))
        if time > MAX_TIME:
            return (
                "the torque is no impulses with rests between them: "
                f"{100 * IMPULSIVE_POWER:g} % of its power take {100 * time:.0f} % of the time (at "
                f"most {100 * MAX_TIME:g} %); the joint must ring freely after impulses of torque"
            )
        (stiffness, viscosity, inertia), _ = mean_impedance(ensemble)
        damping = viscosity / (2 * math.sqrt(max(stiffness * inertia, math.ulp(0.0))))
        if not 0 <= damping <= MAX_DAMPING:
            return (
                f"the joint does not ring: its damping ratio is {damping:.2g} ({stiffness:.3g} "
                f"N·m/rad, {viscosity:.3g} N·m·s/rad, {inertia:.3g} kg·m²), and {MAX_DAMPING:g} or "
                "less is needed"
            )
        return None

    def fit(self, ensemble: Ensemble) -> Model:
        """Return the model of an ensemble."""
        samples, rate = ensemble.samples, ensemble.sampling_rate
        average, inertia_error = mean_impedance(ensemble)
        clear, reach = math.ceil(CLEAR * self.window * rate), round(REACH * self.window * rate)
        found = np.full((len(ensemble), samples, 3), np.nan)
        for run in ensemble.runs:
            recorded = ensemble.angle_as_recorded[run, ensemble.core]
            angle = recorded.reshape(len(run) * samples, -1).mean(axis=1)
            size = np.abs(ensemble.torque[run, ensemble.core].ravel())
            peaks, _ = scipy.signal.find_peaks(
                size, MIN_PEAK * size.max(), distance=MIN_DISTANCE_S * rate
            )
            for peak, following in pairwise([*peaks, len(angle)]):
                # Windows that hold nothing but ringing
                latest = peak + clear + round(MAX_RINGING_S * rate)
                last = min(latest, following - clear, len(angle) - reach - 1)
                times = np.arange(max(peak + clear, reach), last + 1)
                if len(times) >= MIN_SAMPLES:
                    realizations = run[times // samples]
                    found[realizations, times % samples] = track(
                        angle, times, self.window, rate, average
                    )
        count = np.isfinite(found).sum(axis=0)
        mean, spread = mean_and_spread(found)
        values = np.hypot(spread / np.sqrt(count), inertia_error / average[-1] * mean)
        errors = shared.standard_errors(values, count - 1.0)
        estimates = shared.impedance_estimates(mean, errors)
        return Model.of(ensemble, estimates=estimates, parameters=2.0)


def mean_impedance(ensemble: Ensemble) -> tuple[Array, float]:
    """Return mean stiffness, viscosity and inertia (3,), and the standard error of the inertia."""
    width = SMOOTHING_S * ensemble.sampling_rate
    smoothed = attrs.evolve(
        ensemble,
        angle=gaussian_filter1d(ensemble.angle, width),
        torque=gaussian_filter1d(ensemble.torque, width),
    )
    estimates = BasisIRF(basis=FourierSeries(HARMONICS)).fit(smoothed).estimates
    mean = np.array([mean_of(each.values) for each in estimates.values()])
    error = estimates["inertia"].standard_error.values  # type: ignore[union-attr]  # birf has one
    return mean, mean_of(error)


def track(
    angle: Array, times: NDArray[np.int64], width: float, rate: float, mean: Iterable[float]
) -> Array:
    """Return the impedance (time, 3) at consecutive samples of an angle that rings.

    In a window about each time, the fit has a wave with the decay of the ``mean`` impedance (3,),
    its mirror image at the negative frequency, and a constant. The wave's phase and size over time
    give frequency and decay. The inertia is the mean one.
    """
    stiffness, viscosity, inertia = mean
    decay = viscosity / (2 * inertia)
    frequency = math.sqrt(stiffness / inertia - decay**2)
    reach = round(REACH * width * rate)
    lags = np.arange(-reach, reach + 1) / rate
    # The square of the decaying wave has equal weights before and after the time.
    weights = np.exp(2 * decay * lags - (lags / width) ** 2 / 2)
    segments = angle[times + np.arange(-reach, reach + 1)[:, None]]
    for _ in range(ROUNDS):
        wave = np.exp((1j * frequency - decay) * lags)
        columns = np.stack([wave, wave.conj(), np.ones_like(wave)])
        weighted = columns.conj() * weights
        amplitude = np.linalg.solve(weighted @ columns.T, weighted @ segments)[0]
        frequencies = np.gradient(np.unwrap(np.angle(amplitude)), 1 / rate)
        frequency = float(np.median(frequencies))
    logarithm = np.log(np.abs(amplitude**2 * frequencies)) / 2
    fade = -np.gradient(logarithm, 1 / rate)  # s of the class's equation
    squares = frequencies**2 + fade**2 + np.gradient(fade, 1 / rate)
    return inertia * np.stack([squares, 2 * fade, np.ones_like(fade)], axis=1)
