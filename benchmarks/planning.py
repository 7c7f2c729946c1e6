"""How often a plan keeps its promise: run ``python benchmarks/planning.py`` from the root.

Simulated joints are planned for a precision, from the stated protocol and from pilots of 20
realizations. The number of realizations that the plan names is then simulated anew. Prints half
the 95 % band that is reached, bias included, beside the precision that was promised.
"""

from __future__ import annotations

import argparse
from itertools import product

import numpy as np
from rich.console import Console
from rich.table import Table

import tvsysid as tv
from tvsysid.metrics import total_error
from tvsysid.planning import Plan, Protocol
from tvsysid.planning.curves import identify_each
from tvsysid.planning.plans import HALF_BAND
from tvsysid.planning.protocol import PINK, Spectrum

WHITE = Spectrum(np.array([0.0, 500.0]), np.ones(2))
NOISES = {"white": WHITE, "pink": PINK}
PILOT = 20  # realizations
TOLERANCE = 1.1  # of a promise, for the chance in the trials that test it
FIRST_TRIAL, FIRST_PILOT = 70_000, 60_000  # seeds


def main() -> None:
    parser = argparse.ArgumentParser(description="How often a plan keeps its promise.")
    parser.add_argument("--trials", type=int, default=12)
    parser.add_argument("--pilots", type=int, default=2)
    parser.add_argument("--precision", type=float, default=8.0)
    parser.add_argument("--stiffness", nargs="+", default=["sine", "constant"])
    parser.add_argument("--perturbation", nargs="+", default=["noise", "prbs"])
    parser.add_argument("--system", default="joint")
    chosen = parser.parse_args()
    table, kept = Table("joint", "plan", "method", "realizations", "promised", "reached"), []
    for stiffness, perturbation, noise in product(chosen.stiffness, chosen.perturbation, NOISES):
        protocol = Protocol(
            chosen.system, stiffness, perturbation, noise_spectrum=NOISES[noise], snr_db=10
        )
        plans = {"stated": tv.plan(protocol, chosen.precision)}
        for number in range(chosen.pilots):
            pilot = protocol.simulated(PILOT, FIRST_PILOT + number).ensemble
            plans[f"pilot {number + 1}"] = tv.plan(pilot, chosen.precision, seed=100 * number)
        for name, plan in plans.items():
            for recording in plan.required:
                count = recording.realizations
                if count is None or count > protocol.sizes[-1]:
                    continue
                reached = half_band(protocol, plan, recording.method, count, chosen.trials)
                kept.append((name == "stated", reached <= TOLERANCE * chosen.precision))
                table.add_row(
                    f"{stiffness}, {perturbation}, {noise}",
                    name,
                    recording.method,
                    f"{count}",
                    f"{chosen.precision:g}",
                    f"{reached:.1f}" + ("" if kept[-1][1] else " missed"),
                )
    console = Console(width=120)
    console.print(table)
    for stated in (True, False):
        these = [each for is_stated, each in kept if is_stated == stated]
        console.print(f"{'stated' if stated else 'pilots'}: {sum(these)} of {len(these)} kept")


def half_band(protocol: Protocol, plan: Plan, method: str, count: int, trials: int) -> float:
    """Return 1.96 times the total error that a method reaches with so many realizations."""
    made = [protocol.simulated(count, FIRST_TRIAL + trial) for trial in range(trials)]
    values, _ = identify_each(plan.methods[method].identify, (each.ensemble for each in made))
    return HALF_BAND * total_error(values, made[0].stiffness[0])


if __name__ == "__main__":
    main()
