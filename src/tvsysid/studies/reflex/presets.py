"""A study of joints with a stretch reflex, by methods of one pathway and of two."""

from __future__ import annotations

ONE_PATH = ("eirf", "sds", "birf", "kbr")
TWO_PATHS = ("cascade", "bpc", "tvpc", "pc", "sdss")
GAINS = (4.0, 8.0, 16.0)  # of the reflex in N·m·s/rad, beside 0
FEW, MANY = (100, 300), 600  # realizations; the ensemble cascade is said to need 500 to 800
WINDOWLESS = "tvpc:window=0"  # each time by itself, as its authors have it
PERIOD = 2.0  # s
NAMES = {0.0: "reflex:reflex_gain=0"} | {gain: f"reflex:reflex_gain={gain:g}" for gain in GAINS}
"""Systems of constant gain."""

PRESETS: dict[str, dict[str, object]] = {
    "reflex": {
        "stiffness": ("sine",),
        "perturbation": ("noise",),
        "duration_s": (80.0,),
        "system": ("reflex-sine",),
        "methods": (*ONE_PATH, *TWO_PATHS),
        "trials": 10,
        "subtract_mean": True,
        "also": (
            {"perturbation": ("prbs", "pulses")},
            {"system": ("reflex-sine:noise_bandwidth=1", NAMES[0.0])},
            {"stiffness": ("square",), "system": ("reflex-square",)},
            {"stiffness": ("constant",), "system": ("reflex",), "snr_db": (10.0, 0.0)},
            {
                "system": tuple(NAMES[gain] for gain in GAINS),
                "methods": (*ONE_PATH, *TWO_PATHS[:1]),
            },
            {
                "duration_s": tuple(PERIOD * count for count in (*FEW, MANY)),
                "methods": ("tvpc", WINDOWLESS),
            },
        ),
    }
}
"""Forty realizations of a joint whose stiffness and reflex gain vary in a sine, by noise, PRBS,
pulses, and with slow noise; without a reflex; in a square wave; of a constant joint, with little
and much noise. Further scenarios vary the reflex gain, for methods of one pathway, and the amount
of data, for the ensemble cascade with and without its window."""
