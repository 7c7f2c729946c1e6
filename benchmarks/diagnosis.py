"""How often a diagnosis raises a false alarm: run ``python benchmarks/diagnosis.py`` from the repository root.

Diagnoses clean simulated joints (constant, sinusoidal and square-wave stiffness, filtered noise and PRBS, 40 to 300 s,
5 to 20 dB, decimated to 100 Hz) and prepared virtual participants, and prints every finding (each of which is false),
how near to its threshold each check came, and how long a diagnosis took. Ends with 1 if more than 5 % of the clean
joints have a finding.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from rich.console import Console
from rich.table import Table

import tvsysid as tv

PROFILES = (tv.simulate.SquareWave(), tv.simulate.SineWave(), tv.simulate.Constant(100.0))
PERTURBATIONS = (tv.simulate.FilteredNoise(), tv.simulate.PRBS())
ALLOWED = 0.05
TWO_SIDED = ("delay", "drift")


def main() -> None:
    parser = argparse.ArgumentParser(description="False alarms of a diagnosis.")
    parser.add_argument("--joints", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="seed of the first joint")
    parser.add_argument("--participants", type=int, default=6)
    chosen = parser.parse_args()
    console = Console()
    seeds = range(chosen.first, chosen.first + chosen.joints)
    false = survey(console, "clean joints", ((f"joint {seed}", clean_joint(seed)) for seed in seeds))
    people = ((n, kind) for n in range(1, chosen.participants + 1) for kind in ("noise", "prbs"))
    survey(console, "virtual participants", ((f"participant {n}, {kind}", participant(n, kind)) for n, kind in people))
    sys.exit(int(false > ALLOWED * chosen.joints))


def clean_joint(seed: int) -> tv.Ensemble:
    random = np.random.default_rng(seed)
    duration, snr = 2.0 * random.integers(20, 151), random.uniform(5, 20)
    recording = tv.simulate.joint(
        duration,
        stiffness=PROFILES[seed % 3],
        perturbation=PERTURBATIONS[seed // 3 % 2],
        snr_db=snr,
        seed=seed,
    ).recording
    return tv.preprocess.subtract_mean(tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0))


def participant(number: int, perturbation: str) -> tv.Ensemble:
    trials = getattr(tv.simulate.participant(number), perturbation)
    return tv.preprocess.prepare(trials.recording).ensemble


def survey(console: Console, title: str, ensembles) -> int:  # type: ignore[no-untyped-def]
    """Number of ensembles with a finding."""
    false, seconds, values = 0, [], {name: [] for name in tv.diagnosis.KINDS}
    for name, ensemble in ensembles:
        started = time.perf_counter()
        diagnosis = tv.diagnose(ensemble)
        seconds.append(time.perf_counter() - started)
        false += not diagnosis.clean
        for check in diagnosis.findings:
            console.print(f"{name}: {check.name}: {check.what}", highlight=False)
        for check in diagnosis.checks:
            if check.judged:
                values[check.name].append(abs(check.value) if check.name in TWO_SIDED else check.value)
    if not seconds:
        return 0
    table = Table(title=f"{title}: {false} of {len(seconds)} with a finding", title_justify="left")
    for heading in ("check", "judged", "nearest", "threshold", "unit"):
        table.add_column(heading, justify="left" if heading in ("check", "unit") else "right")
    for name, kind in tv.diagnosis.KINDS.items():
        seen = values[name]
        nearest = f"{(max if kind.wrong == 'above' else min)(seen):.3g}" if seen else "-"
        table.add_row(name, str(len(seen)), nearest, f"{kind.limit:g}", kind.unit)
    console.print(table)
    console.print(
        f"a diagnosis took {np.mean(seconds):.2f} s on average, {max(seconds):.2f} s at most\n", highlight=False
    )
    return false


if __name__ == "__main__":
    main()
