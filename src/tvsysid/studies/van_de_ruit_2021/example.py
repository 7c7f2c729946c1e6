"""Impulse responses of a simulated joint, true and identified, for the picture of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.methods import BasisIRF, EnsembleIRF, Method, ShortDataSegments
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_weights
from tvsysid.preprocess import decimate, segment
from tvsysid.simulate import PERTURBATIONS, PROFILES, Joint
from tvsysid.study.simulated import PERIOD, RATE, Scenario, Study

if TYPE_CHECKING:
    import xarray as xr

SCENARIO = Scenario("square", "prbs", 150.0, 10.0)
INSTANTS = (0.25, 1.0)  # times in s, half-way between two switches: low and high stiffness


def example_responses(seed: int = 0) -> xr.Dataset:
    r"""Impulse responses of the square wave's first trial of 150 s, PRBS, like figure 2 of van de Ruit et al. 2021.

    The true one is that of :math:`I s^2 + b s + k` in the band of the data (up to 80 % of the Nyquist frequency), for a
    response that holds all frequencies has no finite values.

    ``impulse_response`` over (method_key, instant, lag), ``true_impulse_response`` over (instant, lag), and ``distance``
    between them (root mean square over lags) over (method_key, instant), in N·m/(rad·s), with the coordinate
    ``stiffness`` in N·m/rad over (instant). The seed is that of the study.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    simulation = Joint(stiffness=PROFILES[SCENARIO.stiffness]).simulate(
        SCENARIO.duration_s,
        perturbation=PERTURBATIONS[SCENARIO.perturbation],
        snr_db=SCENARIO.snr_db,
        seed=Study(seed=seed).seed_of(SCENARIO, 0),
    )
    ensemble = segment(decimate(simulation.recording, RATE), PERIOD)
    methods: list[Method] = [EnsembleIRF(), ShortDataSegments(), BasisIRF(model="irf")]
    models: list[Any] = [method.identify(ensemble) for method in methods]
    stiffness = np.asarray(PROFILES[SCENARIO.stiffness](np.array(INSTANTS)))
    viscosity = float(simulation.truth["viscosity"][0])
    # Discrete weights of a derivative of order m are those for unit sample time, times the rate to the power m; a
    # response is per second, which is once more the rate.
    weights = derivative_weights(HALF_WIDTH) * RATE ** np.array([[1.0], [2.0], [3.0]])
    inertia = float(simulation.truth["inertia"][0])
    truth = [k * weights[0] + viscosity * weights[1] + inertia * weights[2] for k in stiffness]
    rows = [round(instant * RATE) for instant in INSTANTS]
    dims = ("method_key", "instant", "lag")
    found = np.stack([model.impulse_response[rows] for model in models])
    distance = np.sqrt(np.mean((found - np.stack(truth)) ** 2, axis=-1))
    return xr.Dataset(
        {
            "impulse_response": (dims, found),
            "distance": (dims[:2], distance),
            "true_impulse_response": (dims[1:], np.stack(truth)),
        },
        coords={
            "method_key": ["eirf", "sds", "birf"],
            "instant": list(INSTANTS),
            "stiffness": ("instant", stiffness),
            "lag": np.arange(-HALF_WIDTH, HALF_WIDTH + 1) / RATE,
        },
    )
