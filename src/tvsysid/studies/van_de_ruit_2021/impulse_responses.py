"""Figure 2: impulse responses of the methods that find one, beside the true one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures import Illustration, impulse_responses
from tvsysid.models import IMPEDANCE
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_weights
from tvsysid.study.scenarios import RATE, Study
from tvsysid.study.trials import draw

if TYPE_CHECKING:
    import xarray as xr

METHODS = ("eirf", "sds", "birf:model=irf")
ROWS = [25, 100]  # samples half-way between two switches: low and high stiffness
TITLE = "Impulse responses at a low and a high stiffness: PRBS, 150 s, 10 dB"
TEXT = (
    "Impulse responses over lags in N·m/(rad·s), identified by the methods that find one from a "
    "trial of the square wave, with the paper's settings, drawn over the true one in the band of "
    "the data, at a low and a high stiffness in N·m/rad."
)


def illustration(results: xr.Dataset) -> dict[str, Illustration]:
    """Return the figure for a study with a square wave."""
    shown = Illustration(lambda: impulse_responses(example_responses(), TITLE), TITLE, TEXT)
    return {"impulse-responses": shown} if "square" in results.profile else {}


def example_responses() -> xr.Dataset:
    r"""Return impulse responses of the first trial of 150 s (square wave, PRBS), like figure 2.

    The true one is that of :math:`I s^2 + b s + k` in the band of the data (up to 80 % of the
    Nyquist frequency), for a response that holds all frequencies has no finite values.

    ``impulse_response`` over (method_key, instant, lag) and ``true_impulse_response`` over
    (instant, lag) are in N·m/(rad·s), with the coordinate ``stiffness`` in N·m/rad over (instant).
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    study = Study(perturbation=("prbs",), methods=METHODS)
    ensemble, truth = draw(study, study.scenarios[0], 0)
    methods: Any = study.named_methods.values()
    found = [each.identify(ensemble).impulse_response[ROWS] for each in methods]
    true = np.stack([truth.quantities[name][ROWS] for name in IMPEDANCE], axis=-1)
    # Discrete weights of a derivative of order m are those for unit sample time, times the rate to
    # the power m; a response is per second, which is once more the rate.
    weights = derivative_weights(HALF_WIDTH) * RATE ** np.array([[1.0], [2.0], [3.0]])
    return xr.Dataset(
        {
            "impulse_response": (("method_key", "instant", "lag"), found),
            "true_impulse_response": (("instant", "lag"), true @ weights),
        },
        coords={
            "method_key": list(METHODS),
            "instant": ensemble.time[ROWS],
            "stiffness": ("instant", true[:, 0]),
            "lag": np.arange(-HALF_WIDTH, HALF_WIDTH + 1) / RATE,
        },
    )
