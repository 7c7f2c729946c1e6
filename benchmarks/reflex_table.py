"""How much of a stretch reflex methods take for the stiffness of a joint that does not change.

Run ``python benchmarks/reflex_table.py`` from the repository root. Sixty seconds at 10 dB, five draws: stiffness as
mean and standard deviation in N·m/rad.
"""

import warnings

import numpy as np
from threadpoolctl import threadpool_limits

import tvsysid as tv

DURATION, SNR, FIRST_SEED = 60.0, 10.0, 3000
METHODS = {
    "sds, ±40 ms": "sds:max_lag=0.04,window=1.0",
    "sds, ±120 ms": "sds:max_lag=0.12,window=1.0",
    "sds, ±240 ms": "sds:max_lag=0.24,window=1.0",
    "pc": "pc",
    "sdss": "sdss",
    "cascade": "cascade",
}
SLOW = tv.simulate.StretchReflex(delay=0.05, frequency=10.0, damping=1.0)
Constant, ReflexJoint = tv.simulate.Constant, tv.simulate.ReflexJoint
CASES = {
    "noise, gain 8": (ReflexJoint(stiffness=Constant(100.0), reflex_gain=8.0), "noise"),
    "PRBS, gain 8": (ReflexJoint(stiffness=Constant(100.0), reflex_gain=8.0), "prbs"),
    "pulses, gain 20, stiffness 70": (
        ReflexJoint(stiffness=Constant(70.0), viscosity=1.0, inertia=0.025, reflex_gain=20.0),
        "pulses",
    ),
    "noise, no reflex": (ReflexJoint(stiffness=Constant(100.0), reflex_gain=0.0), "noise"),
    "noise, gain 8, slow muscle": (ReflexJoint(stiffness=Constant(100.0), reflex_gain=8.0, reflex=SLOW), "noise"),
}


def stiffness(method: str, ensemble: tv.Ensemble) -> float:
    """Mean over time; NaN where the method refuses."""
    return float(np.nanmean(tv.methods.parse(method).identify(ensemble).stiffness))


def ensemble_of(case: str, seed: int) -> tv.Ensemble:
    """Realizations of 2 s at 100 Hz, their mean subtracted."""
    joint, perturbation = CASES[case]
    recording = joint.simulate(
        DURATION, perturbation=tv.simulate.PERTURBATIONS[perturbation], snr_db=SNR, seed=seed
    ).recording
    return tv.preprocess.subtract_mean(tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0))


def main(draws: int = 5) -> None:
    """Print the table."""
    warnings.simplefilter("ignore", tv.DataQualityWarning)
    print("| | " + " | ".join(METHODS) + " |\n" + "|---" * (1 + len(METHODS)) + "|")
    for case in CASES:
        ensembles = [ensemble_of(case, FIRST_SEED + draw) for draw in range(draws)]
        cells = []
        for method in METHODS.values():
            found = [stiffness(method, ensemble) for ensemble in ensembles]
            cells.append(f"{np.mean(found):.1f} ± {np.std(found, ddof=1):.1f}")
        print(f"| {case} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
