"""Subtract the mean over realizations, if the perturbation differs between them."""

from __future__ import annotations

from collections.abc import Iterable

import attrs
import numpy as np
import scipy

from tvsysid.errors import InputError
from tvsysid.signals import Ensemble

# Change from sample to sample of the differences between realizations, relative to that of the
# signal. Below, they are noise alone: of the angle, or rounding of the torque.
MIN_DIFFERENCE, ROUNDING = 3e-3, 1e-9
# Between these frequencies a perturbation moves the angle, but hardly a behaviour.
MIN_LINE_HZ, MAX_LINE_HZ = 5.0, 45.0
MIN_LINE_SHARE = 0.5  # of the angle's power in this band
MIN_LINE_CONTRAST = 10.0  # to the shared power two harmonics to either side
MIN_Z_SCORE = 2.0  # standard errors from zero


def subtract_mean(ensemble: Ensemble, channels: Iterable[str] = ()) -> Ensemble:
    """Subtract the mean over realizations from angle and torque, and set ``mean_subtracted``.

    The mean does not respond to the perturbation. It holds the voluntary torque and imposed
    movements. The angle with its mean stays as ``recorded_angle``.

    Parameters
    ----------
    ensemble
        At least two realizations.
    channels
        Channels that lose their mean too: those that act on angle or torque, such as a reference
        signal or the EMG that drives a reflex. A scheduling variable keeps its mean.

    Raises
    ------
    InputError
        For one realization, and for a perturbation that is the same in all realizations. Then their
        angles differ by less than 0.3 % from sample to sample (a perturbation of 0.5 degrees beside
        a movement of 60 degrees leaves 8 %). Or lines at multiples of 1/period hold most of the
        angle's power above 5 Hz, and the rest does not respond like a joint.
    """
    if len(ensemble) < 2:
        raise InputError(
            f"subtract_mean: expected at least two realizations, got {ensemble!r}; record more, or "
            "cut the recording with a shorter period (--period) or less context (--context 0)"
        )
    channels, deviations, same = tuple(channels), {}, []
    for name in ("angle", "torque", *channels):
        values = ensemble.signal(name)
        deviations[name] = values - values.mean(axis=0)
        different, whole = (np.linalg.norm(np.diff(x)) for x in (deviations[name], values))
        if whole and different <= (ROUNDING if name == "torque" else MIN_DIFFERENCE) * whole:
            same.append(name)
    # A reference among the channels was checked above.
    if not channels and _is_repeated(ensemble):
        same.append("perturbation")
    if same:
        raise InputError(
            f"subtract_mean: the {same[0]} is the same in all {len(ensemble)} realizations. "
            "Nothing but noise is left. Use a perturbation that differs between realizations: a "
            "multisine needs lines that are no multiples of 1/period."
        )
    angle, torque = deviations.pop("angle"), deviations.pop("torque")
    return attrs.evolve(
        ensemble,
        angle=angle,
        torque=torque,
        channels={**ensemble.channels, **deviations},
        recorded_angle=ensemble.angle_as_recorded,
        mean_subtracted=True,
    )


def _is_repeated(ensemble: Ensemble) -> bool:
    r"""Return whether only lines at multiples of 1/period move the joint: the same in each period.

    They are not alone if the deviations from the mean respond like a joint too. The energy that the
    joint takes, :math:`\sum_k f_k\, \mathrm{Im}\, Y(k)\, U^*(k)`, then has the same sign at the
    lines and in the deviations. Noise of the torque has the other sign.
    """
    frequency = np.fft.rfftfreq(ensemble.samples, 1 / ensemble.sampling_rate)
    spectra = np.fft.rfft(np.stack([ensemble.angle, ensemble.torque])[..., ensemble.core])
    means = spectra.mean(axis=1, keepdims=True)
    shared, power = np.abs(means[0, 0]) ** 2, np.mean(np.abs(spectra[0]) ** 2, axis=0)
    beside = scipy.ndimage.maximum_filter(shared, footprint=[1, 1, 0, 1, 1], mode="constant")
    band = (frequency >= MIN_LINE_HZ) & (frequency <= MAX_LINE_HZ)
    lines = band & (shared > MIN_LINE_CONTRAST * beside) & (shared > MIN_LINE_SHARE * power)
    if shared[lines].sum() <= MIN_LINE_SHARE * power[band].sum():
        return False
    taken, rest = (
        np.sum(frequency * (torque * angle.conj()).imag, axis=1, where=where)
        for (angle, torque), where in ((means, lines), (spectra - means, band))
    )
    return bool(np.sign(taken) * rest.mean() <= MIN_Z_SCORE * rest.std() / np.sqrt(len(rest)))
