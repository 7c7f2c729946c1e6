"""How well a plan predicts: run ``python benchmarks/planning.py`` from the repository root.

Random error of the stiffness (N·m/rad) of 4 methods, 3 durations and 2 noise levels: as
:func:`tvsysid.plan` predicts it from the stated protocol, as it does from pilots of 20
realizations (simulated, each with another seed), and as it is reached in trials that no plan has
seen.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from rich.console import Console
from rich.table import Table

import tvsysid as tv
from tvsysid.planning.answers import METHODS
from tvsysid.planning.curves import identify_each, scatter

DURATIONS = (40.0, 80.0, 150.0)
NOISES = (10.0, 0.0)  # dB
PILOT = 20  # realizations
FIRST_TRIAL, FIRST_PILOT = 70_000, 60_000  # seeds


def main() -> None:
    parser = argparse.ArgumentParser(description="How well a plan predicts.")
    parser.add_argument("--trials", type=int, default=60)
    parser.add_argument("--pilots", type=int, default=3)
    parser.add_argument("--stiffness", default="sine")
    parser.add_argument("--perturbation", default="noise")
    parser.add_argument("--methods", nargs="+", default=list(METHODS))
    chosen = parser.parse_args()
    console = Console(width=None if sys.stdout.isatty() else 150)
    headings = [
        "method",
        "duration (s)",
        "SNR (dB)",
        "reached",
        "predicted",
        "off (%)",
        "from pilots",
        "off (%)",
    ]
    title = (
        f"{chosen.stiffness}, {chosen.perturbation}: random error (N·m/rad), {chosen.trials} trials"
    )
    table, off = Table(*headings, title=title), []
    for snr in NOISES:
        protocol = tv.planning.Protocol(
            stiffness=chosen.stiffness, perturbation=chosen.perturbation, snr_db=snr
        )
        stated = tv.plan(protocol, methods=chosen.methods)
        pilots = [
            protocol.simulated(PILOT, FIRST_PILOT + number).ensemble
            for number in range(chosen.pilots)
        ]
        piloted = [
            tv.plan(each, methods=chosen.methods, seed=100 * number)
            for number, each in enumerate(pilots)
        ]
        for duration in DURATIONS:
            count = round(duration / protocol.period)
            parts = [
                protocol.simulated(count, FIRST_TRIAL + trial).ensemble
                for trial in range(chosen.trials)
            ]
            for label in chosen.methods:
                reached = scatter(identify_each(tv.methods.parse(label), parts)[0])
                every = [random_error(each, label, count) for each in (stated, *piloted)]
                differ = [100 * (each / reached - 1) for each in every]
                off.append(differ)
                table.add_row(
                    *(
                        label,
                        f"{duration:g}",
                        f"{snr:g}",
                        f"{reached:.2f}",
                        f"{every[0]:.2f}",
                        f"{differ[0]:+.0f}",
                    ),
                    ", ".join(f"{each:.2f}" for each in every[1:]),
                    ", ".join(f"{each:+.0f}" for each in differ[1:]),
                )
    console.print(table)
    for name, values in (("stated", np.array(off)[:, :1]), ("pilots", np.array(off)[:, 1:])):
        if values.size:
            inside = np.count_nonzero(np.abs(values) <= 15)
            console.print(
                f"{name}: {inside} of {values.size} within 15 %, the largest "
                f"{np.abs(values).max():.0f} %, in the mean {values.mean():+.1f} %"
            )


def random_error(plan: tv.Plan, method: str, count: int) -> float:
    """As predicted in a plan's only setup."""
    return (
        next(curve for (_, label), curve in plan.curves.items() if label == method).at(count).random
    )


if __name__ == "__main__":
    main()
