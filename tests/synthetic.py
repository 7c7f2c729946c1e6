"""Make results, summary and claims of a study that resemble real ones, in a short time."""

import json

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.ndimage import uniform_filter1d

from tvsysid.simulate import PROFILES
from tvsysid.study import summarize
from tvsysid.study.scores import METRICS

# Half-width of the smoothing in samples, random error at 150 s in N·m/rad, time in s: see
# docs/simulation.md.
METHODS = {
    "eirf": (1, 9.0, 0.02),
    "sds": (5, 3.2, 0.03),
    "birf": (22, 1.6, 0.15),
    "esm": (11, 3.4, 0.01),
    "kbr": (9, 1.9, 0.90),
}
TIME = np.arange(200) / 100
DURATIONS = (40.0, 80.0, 150.0, 300.0, 600.0)
SQUARE = [
    ("square", perturbation, duration, 10.0)
    for perturbation in ("noise", "prbs")
    for duration in DURATIONS
]
SINE = [("sine", perturbation, 150.0, 10.0) for perturbation in ("noise", "prbs")]


def results_of(scenarios=(*SQUARE, *SINE), methods=tuple(METHODS), trials=6, viscosity="constant"):
    """Results of a study in the layout of tvsysid.study.run.

    A scenario: profile, perturbation, duration, SNR.
    """
    random = np.random.default_rng(7)
    truth = np.stack([1.0 * PROFILES[profile](TIME) for profile, *_ in scenarios])
    sizes = len(scenarios), trials, len(methods)
    stiffness, seconds = np.empty((*sizes, len(TIME))), np.empty(sizes)
    for place, column in np.ndindex(sizes[0], sizes[2]):
        _, _, duration, snr = scenarios[place]
        width, spread, cost = METHODS.get(methods[column].partition(":")[0], (9, 3.0, 0.1))
        smooth = uniform_filter1d(truth[place], 2 * width + 1, mode="wrap")
        spread *= np.sqrt(150 / duration) * 10 ** ((10 - snr) / 20)
        scatter = spread * random.standard_normal((trials, len(TIME)))
        stiffness[place, :, column] = smooth + scatter
        seconds[place, :, column] = cost * (0.5 + duration / 300) * random.uniform(0.9, 1.1, trials)
    off = np.abs(stiffness - truth[:, None, None]) / 100
    varying = np.clip(100 - 25 * off**1.2 - random.uniform(0, 1.5, off.shape), 0, 100)
    whole = varying.mean(axis=-1)
    covarying = "-covarying" if viscosity == "covarying" else ""
    labels = [f"{p}-{q}-{duration:g}s-{snr:g}dB{covarying}" for p, q, duration, snr in scenarios]
    cell = ("scenario", "trial", "method_key")
    study = {
        "stiffness": sorted({p for p, *_ in scenarios}), "perturbation": ["noise", "prbs"],
        "duration_s": sorted({d for _, _, d, _ in scenarios}), "snr_db": [10.0],
        "methods": list(methods),
        "trials": trials, "seed": 0,
    }  # fmt: skip
    return xr.Dataset(
        {
            "estimate": ((*cell, "quantity", "time"), stiffness[..., None, :]),
            "time_varying_vaf": ((*cell, "time"), varying),
            "covered": ((*cell, "quantity", "time"), 1.0 * (off < 0.12)[..., None, :]),
            "vaf": (cell, whole),
            "bandpassed_vaf": (cell, whole - 1.5),
            "seconds": (cell, seconds),
            "warnings": (cell, np.full(sizes, "", dtype=object)),
            "failure": (cell, np.full(sizes, "", dtype=object)),
            "truth": (("scenario", "quantity", "time"), truth[:, None]),
        },
        coords={
            "scenario": labels,
            "quantity": ["stiffness"],
            "unit": ("quantity", ["N m/rad"]),
            **{
                name: ("scenario", [scenario[place] for scenario in scenarios])
                for place, name in enumerate(("profile", "perturbation", "duration_s", "snr_db"))
            },
            "viscosity": ("scenario", [viscosity] * len(scenarios)),
            "asked": (("scenario", "method_key"), np.ones((sizes[0], sizes[2]), dtype=bool)),
            "system": ("scenario", ["joint"] * len(scenarios)),
            "method_key": list(methods),
            "trial": np.arange(trials),
            "time": TIME,
        },
        attrs={
            "study": json.dumps(study),
            "versions": json.dumps(
                {"tvsysid": "0.1.0", "numpy": "2.3.1", "scipy": "1.16.0", "python": "3.12.3"}
            ),
            "machine": "Linux x86_64, 2 cores",
        },
    )


def fail(results, method, trial, reason):
    """Results in which a method failed in a trial of every scenario."""
    place = {"method_key": list(results.method_key.values).index(method), "trial": trial}
    for name in ("estimate", "time_varying_vaf", "covered", "vaf", "bandpassed_vaf", "seconds"):
        results[name][place] = np.nan
    results["failure"][place] = reason
    return results


def summary_of(results):
    """Summary with standard errors from few bootstrap draws, which take less time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tvsysid.study.scores.REPLICATES", 10)
        return summarize(results)


def claims():
    """One claim for each verdict."""
    rows = [
        ("The eIRF method has the lowest bias "
         "error.", "section 3.4", "eirf 4.9, next sds 9.6 N·m/rad", 4.7, 4.5, 4.9,
         "N·m/rad", "holds", ""),
        ("All VAFs exceed 85 "
         "%.", "section 3.4", "lowest 83.1 % (eirf, PRBS, 40 s)", 83.1, 82.0, 84.2, "%",
         "does not hold", "The paper does not say over what the VAF is averaged."),
        ("Bias does not depend on the amount of "
         "data.", "section 5", "slope 0.1", 0.1, -0.2, 0.4, "N·m/rad per decade",
         "undecided", "More trials are needed."),
        ("A sine wave is followed with little "
         "bias.", "appendix", "", np.nan, np.nan, np.nan, "", "not studied",
         "Add the sine profile to the study."),
    ]  # fmt: skip
    names = ["claim", "source", "finding", "estimate", "low", "high", "unit", "verdict", "remark"]
    return pd.DataFrame(rows, columns=names)


def responses_of(methods=("eirf", "sds", "birf")):
    """Impulse responses at a low and a high stiffness."""
    lag, random = np.arange(-12, 13) / 100, np.random.default_rng(3)
    bump = np.exp(-0.5 * (lag / 0.018) ** 2)
    rate = np.gradient(bump, lag)
    shape = 0.02 * np.gradient(rate, lag) + 2.2 * rate
    truth = np.stack([25 * shape + k * bump / 0.045 for k in (50.0, 150.0)])
    scatter = [METHODS.get(method.partition(":")[0], (0, 3.0))[1] for method in methods]
    found = np.stack([truth + 40 * size * random.standard_normal(truth.shape) for size in scatter])
    return xr.Dataset(
        {
            "impulse_response": (("method_key", "instant", "lag"), found),
            "true_impulse_response": (("instant", "lag"), truth),
            "distance": (("method_key", "instant"), np.sqrt(((found - truth) ** 2).mean(axis=-1))),
        },
        coords={
            "method_key": list(methods), "instant": [0.25, 1.0], "lag": lag,
            "stiffness": ("instant", [50.0, 150.0]),
        },
    )  # fmt: skip


def scores_of(told, scenarios, methods, metrics, spread, trials):
    """Make scores of a study from each scenario, method and metric, with replicates.

    The replicates have this spread.
    """
    value = np.array(
        [[[told(s, method, metric) for metric in metrics] for method in methods] for s in scenarios]
    )
    replicates = value[..., None] * (
        1 + spread * np.random.default_rng(1).standard_normal((*value.shape, 200))
    )
    dims = ("scenario", "method_key", "metric")
    traits = ("profile", "perturbation", "duration_s", "snr_db", "viscosity", "system")
    units = {name: unit or "N·m/rad" for name, unit in METRICS.items()}
    return xr.Dataset(
        {
            "value": (dims, value),
            "replicates": ((*dims, "replicate"), replicates),
            "trials": (dims[:2], np.full(value.shape[:2], trials)),
        },
        coords={
            "scenario": [s.label for s in scenarios],
            "method_key": list(methods),
            "metric": list(metrics),
            "asked": (dims[:2], np.ones(value.shape[:2], dtype=bool)),
            "unit": ("metric", [units.get(name, "N·m·s/rad") for name in metrics]),
        }
        | {
            name: ("scenario", list(each))
            for name, *each in zip(traits, *map(tuple, scenarios), strict=True)
        },
        attrs={"study": json.dumps({"rate": 100.0, "period": 2.0})},
    )
