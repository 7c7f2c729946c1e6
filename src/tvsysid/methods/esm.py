"""Ensemble spectral method (ESM)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.impedance import Impedance, second_order_fit
from tvsysid.methods.base import (
    EXCITED_ABOVE,
    Method,
    check_choice,
    check_positive,
    check_window,
    missing_edge,
    padded,
    whole_samples,
)
from tvsysid.methods.evidence import Evidence
from tvsysid.methods.halves import evidence_by_halves
from tvsysid.models import Diagnostics, FrequencyResponseModel
from tvsysid.numerics.spectra import power_share, short_time_spectra
from tvsysid.signals import Ensemble

Stiffness = Literal["dc", "fit"]

FEWEST = 10
"""Realizations below which averaged spectra say little."""
OVERSAMPLED = 1e-6
"""Share of the angle's power in the upper half of the band below which it counts as sampled too fast."""
EXCITED = 1e-6
"""Share of the strongest frequency's input power from which on a frequency counts as excited."""
FIT_BAND = 20.0
"""Highest frequency in Hz of the second-order fit."""

WINDOWS = (0.12, 0.16, 0.20, 0.26, 0.30, 0.36, 0.44, 0.56, 0.70)
"""Windows in s of which a tuned one is the best."""
REFERENCE_LAG = 0.12
"""Lags in s of the impulse response that tuning compares with."""


@dataclass(frozen=True)
class EnsembleSpectral(Method):
    r"""A frequency response at each time, from spectra of short segments averaged over realizations.

    .. math:: H(f, t) = \frac{\overline{S_{yu}(f, t)}}{\overline{S_{uu}(f, t)}}

    (equation 12 of van de Ruit et al. 2021). Segments are Hann-windowed, in angle and torque; their mean is not
    subtracted, for that would take away the very component from which stiffness is read.

    Parameters
    ----------
    window
        Duration of a segment in s, over which the joint is taken as constant.
    stiffness
        ``"dc"``: real part at 0 Hz, as in the paper. Leakage of the inertia's part from the neighbouring frequencies
        biases it by some -2 to -3 N·m/rad. ``"fit"``: stiffness, viscosity and inertia from a second-order fit up to
        20 Hz, weighted by what noise the coherence leaves.

    Notes
    -----
    An even number of samples N is taken from t - N/2 to t + N/2 - 1, under a Hann window that peaks at t and vanishes
    at its first sample, so that the estimate is centred on t.
    """

    window: float = 0.30
    stiffness: Stiffness = "dc"

    key: ClassVar[str] = "esm"
    title: ClassVar[str] = "Ensemble spectral method"
    assumptions: ClassVar[tuple[str, ...]] = (
        "Behaviour is the same in all realizations.",
        "The joint is constant over a short window, which limits the fastest change that is seen "
        "and the resolution in frequency.",
    )

    def __post_init__(self) -> None:
        check_positive(self, window=self.window)
        check_choice(self, "stiffness", Stiffness)

    def _identify(self, ensemble: Ensemble) -> FrequencyResponseModel:
        length = whole_samples(self.window, ensemble)
        if length < 4:
            raise InputError(
                f"EnsembleSpectral: a window of {self.window:g} s has {length} samples at "
                f"{ensemble.sampling_rate:g} Hz; give at least {4 / ensemble.sampling_rate:g} s"
            )
        check_window(f"EnsembleSpectral: windows of {self.window:g} s", length, ensemble)
        before, after = length // 2, (length - 1) // 2
        missing = missing_edge(before, ensemble), missing_edge(after, ensemble)
        first = ensemble.context + missing[0] - before
        last = ensemble.context + ensemble.samples - missing[1] + after
        spectra = short_time_spectra(ensemble.angle[:, first:last], ensemble.torque[:, first:last], length)
        excited = (spectra.uu > EXCITED * spectra.uu.max(axis=1, keepdims=True)).astype(np.float64)
        # A frequency without any input has no response; the smallest number keeps it finite.
        input_power = np.maximum(spectra.uu, np.finfo(float).tiny)
        response: NDArray[np.complex128] = spectra.yu / input_power
        powers = input_power * np.maximum(spectra.yy, np.finfo(float).tiny)
        coherence = np.clip(np.abs(spectra.yu) ** 2 / powers, 0.0, 1.0)
        frequencies = np.asarray(np.fft.rfftfreq(length, 1 / ensemble.sampling_rate), dtype=np.float64)
        unknown = np.full(len(response), np.nan)
        impedance = Impedance(response[:, 0].real, unknown, unknown)
        if self.stiffness == "fit":
            band = frequencies <= FIT_BAND
            noise = np.maximum(spectra.yy * (1 - coherence), 1e-9 * spectra.yy.max())
            impedance = second_order_fit(frequencies[band], response[:, band], (spectra.uu / noise)[:, band])
        return FrequencyResponseModel(
            method=repr(self),
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            stiffness=padded(impedance.stiffness, *missing),
            viscosity=padded(impedance.viscosity, *missing),
            inertia=padded(impedance.inertia, *missing),
            frequency_response=padded(response, *missing),
            frequencies=frequencies,
            coherence=padded(coherence, *missing),
            excited=padded(excited, *missing) > 0,
            segment=length,
            diagnostics=Diagnostics(float(length)),
        )

    def _doubts(self, ensemble: Ensemble) -> Iterator[str]:
        rate = ensemble.sampling_rate
        if power_share(ensemble.angle[:: max(1, len(ensemble) // 64)], rate, rate / 4, math.inf) < OVERSAMPLED:
            yield (
                f"the angle has hardly any power above {rate / 4:.4g} Hz: at {rate:g} Hz the response there is noise, "
                "and so is the prediction of torque; decimate first, to 100 Hz for instance"
            )
        if len(ensemble) < FEWEST:
            yield (
                f"spectra are averaged over only {len(ensemble)} realizations: the response is hardly determined; "
                "record more, or use kbr"
            )

    def _evidence(self, ensemble: Ensemble, seed: int) -> Evidence:
        return evidence_by_halves(self, ensemble, seed, {"window": WINDOWS}, REFERENCE_LAG)

    def _needed_band(self, ensemble: Ensemble) -> tuple[float, float]:
        return 1 / self.window, EXCITED_ABOVE
