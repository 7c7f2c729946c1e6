"""Draw the pictures of the README and of docs/ again.

Run ``python benchmarks/pictures.py`` from the repository root.

Names after it draw some of them alone: ``comparison``, ``adaptive``, ``reflex``,
``reflex-bias``, ``closed-loop-bias``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

import tvsysid as tv
from tvsysid.figures.style import TRUE_LINE, curve, styled
from tvsysid.methods.registry import STUDIED_METHODS
from tvsysid.studies import PRESETS, closed_loop
from tvsysid.studies.reflex import NAMES, ONE_PATH
from tvsysid.studies.reflex import STUDY as REFLEXES

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

DOCS = Path(__file__).parents[1] / "docs"


def studied(**settings: Any) -> tuple[xr.Dataset, pd.DataFrame]:
    results = tv.study.run(tv.study.Study(**settings))
    return results, tv.study.summarize(tv.study.score(results))


def comparison() -> Figure:
    results, summary = studied(
        stiffness=["square"],
        perturbation=["noise"],
        duration_s=[150.0],
        methods=STUDIED_METHODS,
        trials=20,
    )
    labels, metrics = (
        list(map(str, results.scenario.values)),
        {"total_error": tv.figures.METRICS["total_error"]},
    )
    title = "Square wave, filtered noise, 150 s, 10 dB"
    stiffness = results.sel(quantity=["stiffness"])
    return tv.figures.method_comparison(stiffness, summary, labels[0], labels, title, metrics)


def wave(time: Any) -> Any:
    """Stiffness in N·m/rad that changes smoothly and switches twice."""
    phase = np.round(time, 6) % 2
    return 80 + 25 * np.sin(np.pi * phase + 0.7) + 50 * ((phase >= 0.613) & (phase < 1.488))


@styled
def adaptive() -> Figure:
    joint = tv.simulate.Joint(stiffness=wave)
    simulation = joint.simulate(150, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    recording = tv.preprocess.decimate(simulation.recording, 100)
    ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))
    figure = tv.compare(ensemble, ["adaptive", "published"]).plot()
    figure.axes[0].plot(ensemble.time, wave(ensemble.time), zorder=1.3, **TRUE_LINE)
    figure.axes[0].legend(handles=figure.axes[0].lines[-1:], loc="upper right", frameon=False)
    return figure


@styled
def reflex() -> Figure:
    joint = tv.simulate.ReflexJoint(
        stiffness=tv.simulate.SineWave(), reflex_gain=tv.simulate.SineWave(8, 4)
    )
    simulation = joint.simulate(150, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), period=2.0)
    ensemble = tv.preprocess.subtract_mean(ensemble)
    found, truth = tv.compare(ensemble, ["cascade", "kbr", "sds"]), simulation.truth_of(ensemble)
    looks = tv.figures.lines(list(found.models))
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    for axes, name in zip(figure.subplots(1, 2), ("stiffness", "reflex_gain"), strict=True):
        axes.plot(ensemble.time, truth[name].mean(axis=0), **TRUE_LINE)
        for label, model in found.models.items():
            if name in model.estimates:
                values, band = model.estimates[name].values, model.band(name)
                curve(axes, model.time, values, band, **looks[label])
        axes.set_xlabel("time (s)")
    figure.axes[0].set_ylabel("stiffness (N·m/rad)")
    figure.axes[1].set_ylabel("reflex gain (N·m·s/rad)")
    figure.axes[0].legend(ncols=2)
    return figure


def reflex_bias() -> Figure:
    preset = PRESETS["reflex"] | {
        "system": tuple(NAMES.values()),
        "methods": (*ONE_PATH, "cascade"),
        "also": (),
    }
    return REFLEXES.figures(*studied(**preset))["bias-reflex-sine"].draw()


def closed_loop_bias() -> Figure:
    slow = closed_loop.grid(5.0, *closed_loop.ACTUATORS)
    preset = PRESETS["closed-loop"] | slow | {"also": ()}
    return closed_loop.STUDY.figures(*studied(**preset))["bias-5Hz"].draw()


PICTURES: dict[str, Callable[[], Figure]] = {
    "comparison": comparison,
    "adaptive": adaptive,
    "reflex": reflex,
    "reflex-bias": reflex_bias,
    "closed-loop-bias": closed_loop_bias,
}

if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        tv.figures.save(PICTURES[name](), DOCS / f"{name}.png")
