"""A study of joints in closed loop, by methods with and without a reference."""

from __future__ import annotations

from tvsysid.methods import CLOSED_LOOP

OPEN = ("sds", "esm:stiffness=fit", "birf", "kbr", "kbr:weighting=residual")
CLOSED = CLOSED_LOOP
"""Of the methods above, in their order, but for ``kbr`` with white weighting."""
UNWEIGHTED = "kbr:reference=disturbance"
ACTUATORS = (30.0, 100.0, 300.0, 1000.0)  # N·m/rad
IMPOSED = 1e5  # N·m/rad, so stiff that the loop counts as open
SNR = {2.0: 5.0, 5.0: 5.0, 40.0: 10.0}  # dB, by the cut-off of the noise in Hz
SHORT, LONG = 40.0, 150.0  # s


def system(actuator: float, noise: float) -> str:
    """Name of the system with this actuator and noise."""
    return f"loaded:actuator_stiffness={actuator:g},noise_bandwidth={noise:g}"


PRESETS: dict[str, dict[str, object]] = {
    "closed-loop": {
        "stiffness": ("sine",),
        "perturbation": ("noise:cutoff=20",),
        "duration_s": (SHORT,),
        "snr_db": (SNR[40.0],),
        "system": tuple(system(actuator, 40.0) for actuator in (*ACTUATORS, IMPOSED)),
        "methods": (*OPEN, *CLOSED[:3], UNWEIGHTED, CLOSED[3]),
        "trials": 20,
        "subtract_mean": True,
        "also": (
            {
                "snr_db": (SNR[5.0],),
                "system": tuple(system(actuator, 5.0) for actuator in (*ACTUATORS, IMPOSED)),
            },
            {
                "snr_db": (SNR[2.0],),
                "system": tuple(system(actuator, 2.0) for actuator in ACTUATORS),
            },
            {"snr_db": (SNR[5.0],), "system": (system(100.0, 5.0),), "stiffness": ("square",)},
            {"snr_db": (SNR[5.0],), "system": (system(100.0, 5.0),), "duration_s": (LONG,)},
        ),
    }
}
"""Twenty realizations of a joint whose stiffness varies in a sine, on actuators from 30 to
1000 N·m/rad and on one that imposes the angle, with noise of the torque up to 2, 5 and 40 Hz; a
square wave, and a longer record."""
