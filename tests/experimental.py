"""Results, summary and prepared recordings of an experiment, made up with a known structure."""

import json
from types import SimpleNamespace

import numpy as np
import xarray as xr
from tests.synthetic import claims  # noqa: F401  # those of either study

import tvsysid as tv
from tvsysid.study import summarize as summary_of

# Bias in N·m/rad, spread over bootstraps of 75 realizations in N·m/rad, VAF in per cent, time in s.
METHODS = {
    "eirf": (-2.0, 9.0, 62.0, 0.06),
    "sds": (-5.0, 5.0, 57.0, 0.08),
    "birf": (-7.0, 3.0, 53.0, 0.4),
    "esm": (6.0, 6.0, 50.0, 0.03),
    "kbr": (-9.0, 4.0, 66.0, 1.5),
}
AMOUNTS = (75, 150)
FEW = (20, 40)
SIGNALS = ("noise", "prbs")
STEPS = (2, 7, 31)
"""Realizations that each step excludes."""
LATE = 20
"""Further realizations that a PRBS makes come late."""
RATE = 128.0


def results_of(
    participants=("P1", "P2", "P3"),
    perturbations=SIGNALS,
    methods=tuple(METHODS),
    amounts=AMOUNTS,
    bootstraps=6,
    period=2.0,
    truth=True,
    target=True,
):
    """Results of an experiment; the spread falls with the square root of the realizations drawn."""
    random = np.random.default_rng(11)
    time = np.arange(round(period * RATE)) / RATE
    recordings = [(person, signal) for person in participants for signal in perturbations]
    analyses = [
        (method, amount)
        for method in methods
        for amount in (FEW[: len(amounts)] if method.startswith("kbr") else amounts)
    ]
    sizes = len(recordings), len(analyses), bootstraps, len(time)
    wave = 15.0 - 10.0 * np.cos(2 * np.pi * time / period)
    torque, stiffness = np.empty((sizes[0], sizes[3])), np.empty(sizes)
    varying, whole, seconds = np.empty(sizes), np.empty(sizes[:3]), np.empty(sizes[:3])
    true = np.empty_like(torque)
    for place, (person, signal) in enumerate(recordings):
        strength = 1 + 0.1 * participants.index(person)
        torque[place] = strength * wave
        true[place] = 35 + 4 * torque[place]
        for column, (method, amount) in enumerate(analyses):
            bias, spread, level, cost = METHODS.get(method.partition(":")[0], (0.0, 6.0, 55.0, 0.2))
            usual = FEW[0] if method.startswith("kbr") else AMOUNTS[0]
            noise = random.standard_normal((bootstraps, 8)) @ _bumps(time, period)
            stiffness[place, column] = true[place] + bias + spread * np.sqrt(usual / amount) * noise
            level += 20 * (signal != "noise" and not method.startswith("kbr")) + 2 * min(
                participants.index(person), 5
            )
            whole[place, column] = level + 1.5 * random.standard_normal(bootstraps)
            varying[place, column] = np.clip(
                whole[place, column][:, None]
                + 12 * np.sin(4 * np.pi * time / period)
                + random.normal(0, 2, sizes[2:]),
                0,
                100,
            )
            seconds[place, column] = cost
    late = np.array([LATE * (signal == "prbs") for _, signal in recordings])
    counts = STEPS
    nothing = np.full_like(torque, np.nan)
    cell, every = ("recording", "analysis", "bootstrap"), np.ones(sizes[0], dtype=int)
    return xr.Dataset(
        {
            "estimate": ((*cell, "quantity", "time"), stiffness[..., None, :]),
            "time_varying_vaf": ((*cell, "time"), varying),
            "vaf": (cell, whole),
            "bandpassed_vaf": (cell, whole - 4.0),
            "seconds": (cell, seconds),
            "warnings": (cell, np.full(sizes[:3], "", object)),
            "failure": (cell, np.full(sizes[:3], "", object)),
            "target_torque": (("recording", "time"), 1.05 * torque if target else nothing),
            "mean_torque": (("recording", "time"), torque),
            "truth": (("recording", "quantity", "time"), (true if truth else nothing)[:, None]),
            "recorded": ("recording", 300 * every),
            "survivors": ("recording", 300 - sum(counts) - late),
            "excluded_alignment": ("recording", counts[0] + late),
            "excluded_task": ("recording", counts[1] * every),
            "excluded_residual": ("recording", counts[2] * every),
            "remarks": ("recording", np.full(sizes[0], "", dtype=object)),
        },
        coords={
            "recording": [f"{person}-{signal}" for person, signal in recordings],
            "quantity": ["stiffness"], "unit": ("quantity", ["N m/rad"]),
            "participant": ("recording", [person for person, _ in recordings]),
            "perturbation": ("recording", [signal for _, signal in recordings]),
            "analysis": [f"{method}-{amount}" for method, amount in analyses],
            "method_key": ("analysis", [method for method, _ in analyses]),
            "realizations": ("analysis", [amount for _, amount in analyses]),
            "bootstrap": np.arange(bootstraps),
            "time": time,
        },
        attrs={
            "experiment": json.dumps(
                {
                    "participants": list(participants), "methods": list(methods),
                    "bootstraps": bootstraps, "seed": 0,
                    "period": period, "reference": "target" if target else None, "max_shift": 0.25,
                }
            ),
            "versions": json.dumps({"tvsysid": "0.1.0", "numpy": "2.3.1", "python": "3.12.3"}),
        },
    )  # fmt: skip


def _bumps(time, period):
    """Smooth periodic functions of unit variance in sum, shape (8, time)."""
    phases = 2 * np.pi * (time / period - np.arange(8)[:, None] / 8)
    shapes = np.exp(4 * (np.cos(phases) - 1))
    return shapes / np.sqrt(np.square(shapes).sum(axis=0))


def fail(results, reason, recording=None, analysis=None):
    """Results in which analyses failed: one, all of a recording, or one of every recording."""
    place = {"recording": recording, "analysis": analysis}
    at = {name: label for name, label in place.items() if label is not None}
    for values in results.values():
        if {*at} <= {*values.dims} and values.dtype.kind in "if":
            values.loc[at] = 0 if values.dims == ("recording",) else np.nan
    results["failure"].loc[at] = reason
    return results


def prepared_of(results, preparation=None, rate=1024.0):
    """What figures show of recordings: ten seconds with a target, and how they were prepared."""
    random = np.random.default_rng(5)
    time = np.arange(round(10 * rate)) / rate
    wave = 15 - 10 * np.cos(np.pi * time)
    return [
        SimpleNamespace(
            recorded=SimpleNamespace(label=label, participant=person, perturbation=signal),
            ensemble="some",
            excerpt=tv.Recording(
                0.009 * random.standard_normal(len(time)),
                wave + random.standard_normal(len(time)),
                rate,
                start=20.0,
                channels={"target": wave},
            ),
            preparation=preparation,
        )
        for label, person, signal in zip(
            *(results[name].values for name in ("recording", "participant", "perturbation")),
            strict=True,
        )
    ]


def experiment_of(**words):
    """Results and summary."""
    results = results_of(**words)
    return SimpleNamespace(results=results, summary=summary_of(results))
