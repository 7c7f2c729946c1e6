"""What is said of joints in closed loop, held against the scores of a study.

The thresholds are ours.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tvsysid.numerics import Array
from tvsysid.studies.closed_loop.presets import (
    ACTUATORS,
    CLOSED,
    IMPOSED,
    LONG,
    OPEN,
    SHORT,
    SNR,
    UNWEIGHTED,
    system,
)
from tvsysid.studies.scored import Margins, Scores, judged_by, margin
from tvsysid.studies.van_de_ruit_2021.simulations import Replicated
from tvsysid.studies.verdicts import RATIO, Claim, log_ratio
from tvsysid.study.scenarios import Scenario

if TYPE_CHECKING:
    import xarray as xr

LOSES = 18.0  # N·m/rad, of 100
LITTLE = 5.0  # N·m/rad that wide-band noise costs at most
STAYS = 0.1  # share by which the bias in a longer record may be smaller
FREE, NEARLY = (
    1.5,
    2.5,
)  # N·m/rad of bias that kbr with a reference and weights may have, and esm and birf
LEAST, MOST = 90.0, 97.0  # % of coverage of the 95 % bands
ALIKE = 0.02  # share by which a reference may make the random error larger where there is no loop
GAINS, COSTS = (
    0.25,
    0.06,
)  # shares by which weighting lowers the random error at least, and makes it larger at most
WHITE, WEIGHTED, BEST = OPEN[3], OPEN[4], CLOSED[3]
PLACES = tuple(
    itertools.product(SNR, ACTUATORS)
)  # noise and actuator of every sine wave in closed loop


def scenario(actuator: float, noise: float, duration_s: float = SHORT) -> Scenario:
    """Return the scenario of a sine wave on this actuator with this noise."""
    return Scenario(
        "sine", "noise:cutoff=20", duration_s, SNR[noise], "constant", system(actuator, noise)
    )


def judge(scores: xr.Dataset) -> pd.DataFrame:
    """Hold every claim against the scores of a study.

    Columns are those of the claims of a published study.
    """
    return judged_by(CLAIMS, scores)


def _where(actuator: float, noise: float) -> str:
    return f"on {actuator:g} N·m/rad, noise up to {noise:g} Hz"


def _bias(methods: Sequence[str], noises: Sequence[float], limit: float, loses: bool) -> Margins:
    """Test that each method's mean bias is below -limit, or within it."""

    def margins(scores: Scores) -> Iterator[Replicated]:
        for method, noise, actuator in itertools.product(methods, noises, ACTUATORS):
            for bias in scores.of((scenario(actuator, noise), method, "mean_bias")):
                words = f"mean bias of {method} {bias[0]:.1f} N·m/rad {_where(actuator, noise)}"
                yield margin(words, -limit - bias if loses else limit - np.abs(bias))

    return margins


def _stays(scores: Scores) -> Iterator[Replicated]:
    for method in OPEN[:4]:
        places = (scenario(100.0, 5.0, LONG), scenario(100.0, 5.0))
        if found := scores.of(*((place, method, "mean_bias") for place in places)):
            late, early = found
            words = (
                f"mean bias of {method} {late[0]:.1f} N·m/rad in {LONG:g} s, {early[0]:.1f} "
                f"in {SHORT:g} s"
            )
            yield margin(words, log_ratio(np.abs(late), np.abs(early)) - np.log1p(-STAYS))


def _covers(*methods: str) -> Margins:
    """Test that the bands of methods have their nominal coverage in every closed loop."""

    def margins(scores: Scores) -> Iterator[Replicated]:
        for method, (noise, actuator) in itertools.product(methods, PLACES):
            for share in scores.of((scenario(actuator, noise), method, "coverage")):
                words = (
                    f"the bands of {method} hold the truth in {share[0]:.1f} % "
                    f"{_where(actuator, noise)}"
                )
                yield from (margin(words, limit) for limit in (share - LEAST, MOST - share))

    return margins


def _ratio(
    scores: Scores, place: Scenario, one: str, other: str, where: str
) -> tuple[str, Array] | None:
    """Return the log ratio of two methods' random errors, and its description."""
    found = scores.of(*((place, method, "random_error") for method in (one, other)))
    if not found:
        return None
    return (
        f"random error of {one} {found[0][0]:.1f}, of {other} {found[1][0]:.1f} N·m/rad {where}",
        log_ratio(*found),
    )


def _costs_nothing(scores: Scores) -> Iterator[Replicated]:
    for (rival, method), noise in itertools.product(
        zip((*OPEN[1:3], WEIGHTED), CLOSED[1:], strict=True), (5.0, 40.0)
    ):
        if found := _ratio(scores, scenario(IMPOSED, noise), method, rival, _where(IMPOSED, noise)):
            yield margin(found[0], np.log1p(ALIKE) - found[1])


def _weighting(scores: Scores) -> Iterator[Replicated]:
    every = [(noise, actuator, UNWEIGHTED, BEST) for noise, actuator in PLACES]
    for noise, actuator, one, other in [*every, (5.0, IMPOSED, WHITE, WEIGHTED)]:
        if found := _ratio(scores, scenario(actuator, noise), one, other, _where(actuator, noise)):
            yield margin(found[0], found[1] + (np.log1p(-GAINS) if noise < 40 else np.log1p(COSTS)))


N_M, PRESET = "N·m/rad", "the preset closed-loop"
LUDVIG = "Ludvig and Kearney 2009"
OWN = "this package"
CLAIMS: tuple[Claim, ...] = (
    Claim(f"Without a reference slow noise (5 Hz, 5 dB) takes over {LOSES:g} of 100 N·m/rad, "
          "whatever the actuator",
          LUDVIG, _bias(OPEN[:4], (5.0,), LOSES, loses=True), N_M, f"methods without a reference "
                                                                   f"({PRESET})"),
    Claim(f"A longer record does not mend it (by {100 * STAYS:g} % at most)", OWN, _stays, RATIO,
          f"40 and 150 s of methods without a reference ({PRESET})"),
    Claim(f"Noise up to 40 Hz at 10 dB takes less than {LITTLE:g} N·m/rad", OWN,
          _bias(OPEN[:4], (40.0,), LITTLE, loses=False), N_M, f"methods without a reference "
                                                              f"({PRESET})"),
    Claim(f"kbr with a reference and weights is off by less than {FREE:g} N·m/rad on any actuator",
          "van der Helm et al. "
          "2002", _bias((BEST,), tuple(SNR), FREE, loses=False), N_M, f"{BEST} ({PRESET})"),
    Claim(f"esm and birf with a reference are off by less than {NEARLY:g} N·m/rad on any actuator",
          "van der Helm et al. 2002", _bias(CLOSED[1:3], tuple(SNR), NEARLY, loses=False), N_M,
          f"{' and '.join(CLOSED[1:3])} ({PRESET})"),
    Claim(f"The bands of kbr with a reference and weights hold the truth in {LEAST:g} to {MOST:g} "
          "%, on any actuator",
          OWN, _covers(BEST), "%", f"{BEST} ({PRESET})"),
    Claim("Those of esm and birf with a reference do so too", OWN, _covers(*CLOSED[1:3]), "%",
          f"{' and '.join(CLOSED[1:3])} ({PRESET})"),
    Claim(f"Where the angle is imposed a reference costs nothing (random error to within "
          f"{100 * ALIKE:g} %)", OWN,
          _costs_nothing, RATIO, f"an actuator of {IMPOSED:g} N·m/rad ({PRESET})"),
    Claim(f"Weighting by the residual takes {100 * GAINS:g} % off kbr's random error under slow "
          "noise, and adds less "
          f"than {100 * COSTS:g} % under wide-band noise", OWN, _weighting, RATIO,
          f"kbr with both weightings ({PRESET})"),
)  # fmt: skip
