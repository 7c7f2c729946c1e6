"""Measure how good the method is that ``tv.recommend`` names.

Run ``python benchmarks/recommend.py`` from the repository root.

Ten kinds of simulated ensembles, four of each. All methods that apply identify each, at their
defaults and tuned; the error is the root mean square of stiffness less the truth over all
realizations and times. The method named is right where its error is at most 1.2 times the smallest
of all; "none" is right where the smallest is above 30 % of the mean stiffness, and naming a method
is wrong there. The smallest of some fifteen errors is small by chance, too: beside each ensemble by
itself, a table has the errors of each kind, as root mean squares over its ensembles, of which one
method is the best.

Some 10 minutes of processor time. Results are kept in ``--out``, and what is in there is not
computed again.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import tvsysid as tv
from tvsysid.simulate import (
    PRBS,
    CompliantActuator,
    Constant,
    FilteredNoise,
    Joint,
    ReflexJoint,
    ScheduledJoint,
    SineWave,
    SquareWave,
)

Array = NDArray[np.float64]
# A method is right up to this multiple of the smallest error, unless its error exceeds this
# share of the mean stiffness
FACTOR, LIMIT = (1.2, 0.3)
FEW, RATE, PERIOD = (2, 3, 4, 5), 100.0, 2.0
REFERENCE, VARIABLE = "disturbance", "emg"
SINGLE = ["eirf", "sds", "esm", "esm:stiffness=fit", "birf", "kbr", "adaptive", "cascade"]
SINGLE += [
    "birf:tuned=true",
    "kbr:weighting=residual",
    "kbr:tuned=true",
    "kbr:weighting=residual,tuned=true",
]
LOOPED = [f"{each}:reference={REFERENCE}" for each in ("birf", "kbr")]
LOOPED += [f"{each}:reference={REFERENCE},tuned=true" for each in ("birf", "kbr")]
LOOPED += [f"kbr:reference={REFERENCE},weighting=residual{each}" for each in ("", ",tuned=true")]
SCHEDULED = [f"{each}:variable={VARIABLE}" for each in ("lpv", "lpvkbi")]


def two_bumps(time: Array) -> Array:
    """Stiffness that rises twice, of no few harmonics."""
    beside = [(time % PERIOD - centre) / width for centre, width in ((0.5, 0.1), (1.3, 0.15))]
    return np.asarray(60 + 60 * np.exp(-(beside[0] ** 2) / 2) + 40 * np.exp(-(beside[1] ** 2) / 2))


def two_tones(time: Array) -> Array:
    """Stiffness of two harmonics."""
    return np.asarray(100 + 30 * np.sin(np.pi * time + 0.4) + 20 * np.sin(3 * np.pi * time + 1))


def burst(time: Array) -> Array:
    """Stiffness that is doubled for a short time."""
    return np.where((time % PERIOD > 0.6) & (time % PERIOD < 0.75), 140.0, 70.0)


SMOOTH = (SineWave(), two_bumps, two_tones, Constant())
SUDDEN = (SquareWave(offset=0.374), burst)
ANY = (SineWave(), SUDDEN[0], two_tones, burst)


class Data(NamedTuple):
    """What an ensemble is simulated from.

    ``named`` is what the recommendation is told of its channel.
    """

    joint: Joint
    duration: float
    snr_db: float
    perturbation: Any = None
    named: dict[str, str] = {}  # noqa: RUF012  # nobody writes to it


def plain(duration: float, snr_db: float, waves: tuple[Any, ...], seed: int) -> Data:
    """A joint whose angle is imposed."""
    return Data(Joint(stiffness=waves[seed % len(waves)]), duration, snr_db)


def few(seed: int) -> Data:
    return Data(Joint(stiffness=ANY[(seed + seed // 4) % 4]), PERIOD * FEW[seed % 4], 10)


def weak(seed: int) -> Data:
    return Data(Joint(stiffness=ANY[seed // 2 % 4]), 40, (-5, -16)[seed % 2])


def loop(seed: int, noises: tuple[tuple[float, float], ...], **named: str) -> Data:
    """Return a joint on a load of 30 or 300 N·m/rad, with noise of some bandwidth and level.

    The bandwidth is in Hz, the level in dB.
    """
    bandwidth, snr_db = noises[seed % len(noises)]
    load = (30.0, 300.0)[seed // 2 % 2]
    joint = CompliantActuator(
        ANY[seed % 4], actuator_stiffness=load, noise_bandwidth=bandwidth, disturbance="torque"
    )
    return Data(joint, 60, snr_db, FilteredNoise(20.0), named)


def slow_noise(seed: int) -> Data:
    joint = ReflexJoint(
        stiffness=ANY[seed % 4], reflex_gain=0.0, noise_bandwidth=(2.0, 4.0)[seed // 2 % 2]
    )
    return Data(joint, 60, 5)


def short(seed: int) -> Data:
    return Data(Joint(stiffness=ANY[seed % 4]), 16, 10, PRBS())


def scheduled(seed: int) -> Data:
    joint = ScheduledJoint(variation=(0.3, 0.5)[seed // 2 % 2], variable=VARIABLE)
    return Data(joint, 80, 10, None, {"scheduling": VARIABLE})


def reflex(seed: int) -> Data:
    return Data(ReflexJoint(stiffness=ANY[seed % 4], reflex_gain=(8.0, 4.0)[seed // 2 % 2]), 60, 10)


KINDS: dict[str, Callable[[int], Data]] = {
    "fast change": partial(plain, 80, 10, SUDDEN),
    "slow change": partial(plain, 80, 10, SMOOTH),
    "short record": short,
    "few realizations": few,
    "weak excitation": weak,
    "reflex": reflex,
    "slow noise": slow_noise,
    "loop with a reference": partial(loop, noises=((5.0, 5.0), (40.0, 5.0)), reference=REFERENCE),
    "loop without a reference": partial(loop, noises=((5.0, 5.0), (5.0, -5.0))),
    "follows a variable": scheduled,
}


def result(kind: str, seed: int) -> dict[str, Any]:
    """What is recommended, and the error of each method in N·m/rad."""
    data = KINDS[kind](seed)
    perturbation = data.perturbation or (FilteredNoise(), PRBS())[seed % 2]
    # The same seed gives every kind noise of its own.
    own = np.random.SeedSequence([seed, list(KINDS).index(kind)])
    simulation = data.joint.simulate(
        data.duration, perturbation=perturbation, snr_db=data.snr_db, seed=own
    )
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, RATE), PERIOD)
    ensemble = tv.preprocess.subtract_mean(
        ensemble, [data.named["reference"]] if "reference" in data.named else []
    )
    truth, found = simulation.truth_of(ensemble)["stiffness"], tv.recommend(ensemble, **data.named)
    methods = (
        SINGLE
        + (LOOPED if "reference" in data.named else [])
        + (SCHEDULED if "scheduling" in data.named else [])
    )
    errors = {
        typed: error_of(typed, ensemble, truth)
        for typed in dict.fromkeys([*methods, *found.suited[:1]])
    }
    named = found.suited[0] if found.suited else ""
    return {
        "kind": kind,
        "seed": seed,
        "named": named,
        "mean": float(truth.mean()),
        "errors": errors,
    }


def error_of(typed: str, ensemble: tv.Ensemble, truth: Array) -> float | None:
    """Root mean square error of stiffness where it is known, which must be nearly everywhere.

    None without one.
    """
    try:
        values = tv.methods.parse(typed).identify(ensemble).estimates["stiffness"].values
    except ValueError:  # one that cannot serve these data, or fails on them
        return None
    off = np.broadcast_to(values, truth.shape) - truth
    return float(np.sqrt(np.nanmean(off**2))) if np.isfinite(off).mean() > 0.9 else None


def smallest(result: dict[str, Any]) -> float:
    return min(error for error in result["errors"].values() if error is not None)


def right(result: dict[str, Any]) -> bool:
    """Whether the method named is good enough, or rightly none is named."""
    if smallest(result) > LIMIT * result["mean"]:
        return not result["named"]
    return bool(result["named"]) and result["errors"][result["named"]] <= FACTOR * smallest(result)


def by_ensemble(results: list[dict[str, Any]]) -> Table:
    """A row for each ensemble."""
    table = Table(title=f"{sum(map(right, results))} of {len(results)} right")
    for heading in ("kind", "seed", "named", "its error", "smallest", "by", "ratio", "right"):
        table.add_column(heading)
    for each in results:
        least, named = smallest(each), each["named"]
        best = next(typed for typed, error in each["errors"].items() if error == least)
        own = each["errors"][named] if named else math.nan
        told = [
            f"{own:.2f}",
            f"{least:.2f}",
            best,
            f"{own / least:.2f}",
            "yes" if right(each) else "NO",
        ]
        table.add_row(each["kind"], str(each["seed"]), named or "none", *told)
    return table


def by_kind(results: list[dict[str, Any]]) -> Table:
    """A row for each kind: how often right, and errors as root mean squares over its ensembles."""
    table = Table(title="Root mean square of the errors, in N·m/rad, where a method was named")
    for heading in (
        "kind",
        "right",
        "what is named",
        "adaptive always",
        "one method that is best",
        "ratio",
    ):
        table.add_column(heading)
    for kind in dict.fromkeys(each["kind"] for each in results):
        own = [each for each in results if each["kind"] == kind]
        named = [each for each in own if each["named"]]
        cells = [f"{sum(map(right, own))} of {len(own)}"]
        if named:
            typed = [
                name
                for name in named[0]["errors"]
                if all(each["errors"].get(name) for each in named)
            ]
            roots = {name: root([each["errors"][name] for each in named]) for name in typed}
            best = min(roots, key=lambda name: roots[name])
            ours = root([each["errors"][each["named"]] for each in named])
            always = f"{roots['adaptive']:.2f}" if "adaptive" in roots else "does not apply"
            cells += [
                f"{ours:.2f}",
                always,
                f"{roots[best]:.2f} ({best})",
                f"{ours / roots[best]:.2f}",
            ]
        table.add_row(kind, *cells)
    return table


def root(errors: list[float]) -> float:
    return math.sqrt(float(np.mean(np.square(errors))))


def main() -> None:
    parser = argparse.ArgumentParser(description="How good the method is that tv.recommend names.")
    parser.add_argument("--first", type=int, default=0, help="first of the four seeds")
    parser.add_argument("--kinds", choices=KINDS, nargs="+", default=list(KINDS))
    parser.add_argument("--out", type=Path, default=Path("recommend.jsonl"))
    chosen = parser.parse_args()
    warnings.simplefilter("ignore", tv.DataQualityWarning)
    lines = chosen.out.read_text().splitlines() if chosen.out.exists() else []
    known = {(each["kind"], each["seed"]): each for each in map(json.loads, lines)}
    results = []
    with threadpool_limits(1), chosen.out.open("a") as file:
        for seed in range(chosen.first, chosen.first + 4):
            for kind in chosen.kinds:
                if (kind, seed) not in known:
                    known[kind, seed] = result(kind, seed)
                    print(json.dumps(known[kind, seed]), file=file, flush=True)
                results.append(known[kind, seed])
    console = Console(width=None if sys.stdout.isatty() else 150)
    results.sort(key=lambda each: chosen.kinds.index(each["kind"]))
    console.print(by_ensemble(results))
    console.print(by_kind(results))


if __name__ == "__main__":
    main()
