"""What is said of joints in closed loop, held against the scores of a study; the thresholds are ours."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from tvsysid.numerics import Array
from tvsysid.studies.closed_loop.presets import ACTUATORS, CLOSED, IMPOSED, LONG, OPEN, SHORT, SNR, system
from tvsysid.studies.scored import Margins, Scores, judged_by, margin
from tvsysid.studies.van_de_ruit_2021.simulations import ALIKE, Replicated
from tvsysid.studies.verdicts import RATIO, Claim, log_ratio
from tvsysid.study.simulated import Scenario

if TYPE_CHECKING:
    import xarray as xr

LOSES = 15.0  # N·m/rad, of 100
LITTLE = 6.0  # N·m/rad that wide-band noise costs at most
PART = 0.25  # of the bias without a reference that one with it may have
LEAST, MOST = 90.0, 97.0  # % of coverage of the 95 % bands
GAINS = 1.25  # ratio of random errors from which on a method counts as better
WHITE, WEIGHTED, BEST = OPEN[3], OPEN[4], CLOSED[3]


def scenario(actuator: float, noise: float, duration_s: float = SHORT) -> Scenario:
    """Sine wave on this actuator with this noise."""
    return Scenario("sine", "noise:cutoff=20", duration_s, SNR[noise], "constant", system(actuator, noise))


def judge(scores: xr.Dataset) -> pd.DataFrame:
    """Hold every claim against the scores of a study; columns are those of the claims of a published study."""
    return judged_by(CLAIMS, scores)


def _where(actuator: float, noise: float) -> str:
    return f"on {actuator:g} N·m/rad, noise up to {noise:g} Hz"


def _bias(methods: Sequence[str], noises: Sequence[float], limit: float, loses: bool) -> Margins:
    """That each method's mean bias is below -limit, or within it."""

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
            words = f"mean bias of {method} {late[0]:.1f} N·m/rad in {LONG:g} s, {early[0]:.1f} in {SHORT:g} s"
            yield margin(words, log_ratio(np.abs(late), np.abs(early)) + np.log1p(ALIKE))


def _mends(scores: Scores) -> Iterator[Replicated]:
    rivals = zip((*OPEN[:3], WHITE), CLOSED, strict=True)
    for (rival, method), actuator in itertools.product(rivals, ACTUATORS):
        if found := scores.of(*((scenario(actuator, 5.0), each, "mean_bias") for each in (method, rival))):
            own, other = found
            words = f"mean bias of {method} {own[0]:.1f}, of {rival} {other[0]:.1f} N·m/rad {_where(actuator, 5.0)}"
            yield margin(words, PART * np.abs(other) - np.abs(own))


def _pooled(scores: Scores, metric: str, noises: Iterable[float], *methods: str) -> list[Array]:
    """Metric of each method in a sine on all actuators that give way, (scenario, draw); none if the study lacks any."""
    places = [scenario(actuator, noise) for noise, actuator in itertools.product(noises, ACTUATORS)]
    found = scores.of(*((place, method, metric) for method in methods for place in places))
    return np.split(np.array(found), len(methods)) if found else []


def _covers(scores: Scores) -> Iterator[Replicated]:
    for each in _pooled(scores, "coverage", SNR, BEST):
        mean = each.mean(axis=0)
        words = f"the bands of {BEST} hold the truth in {mean[0]:.1f} % on average, {each[:, 0].min():.0f} at least"
        yield from (margin(words, limit) for limit in (mean - LEAST, MOST - mean))


def _costs_nothing(scores: Scores) -> Iterator[Replicated]:
    for (rival, method), noise in itertools.product(zip(OPEN[1:3], CLOSED[1:3], strict=True), (5.0, 40.0)):
        if found := scores.of(*((scenario(IMPOSED, noise), each, "random_error") for each in (method, rival))):
            words = f"random error of {method} {found[0][0]:.1f}, of {rival} {found[1][0]:.1f} N·m/rad, {noise:g} Hz"
            yield margin(words, np.log1p(ALIKE) - log_ratio(*found))


def _weighting(scores: Scores) -> Iterator[Replicated]:
    for noise in (5.0, 40.0):
        if found := _pooled(scores, "random_error", (noise,), WHITE, WEIGHTED):
            ratio = log_ratio(*found).mean(axis=0)
            words = f"random error of {WHITE} over that of {WEIGHTED} {np.exp(ratio[0]):.2f}, noise up to {noise:g} Hz"
            yield margin(words, ratio - np.log(GAINS) if noise < 40 else ratio + np.log1p(ALIKE))


N_M, PRESET = "N·m/rad", "the preset closed-loop"
LUDVIG = "Ludvig and Kearney 2009"
OWN = "this package"
CLAIMS: tuple[Claim, ...] = (
    Claim(f"Without a reference slow noise (5 Hz, 5 dB) takes over {LOSES:g} of 100 N·m/rad, whatever the actuator",
          LUDVIG, _bias(OPEN[:4], (5.0,), LOSES, loses=True), N_M, f"methods without a reference ({PRESET})"),
    Claim(f"A longer record does not mend it (to within {100 * ALIKE:g} %)", OWN, _stays, RATIO,
          f"40 and 150 s of methods without a reference ({PRESET})"),
    Claim(f"Noise up to 40 Hz at 10 dB takes less than {LITTLE:g} N·m/rad", OWN,
          _bias(OPEN[:4], (40.0,), LITTLE, loses=False), N_M, f"methods without a reference ({PRESET})"),
    Claim(f"A reference frees of it (of {100 * (1 - PART):g} % at least)", "van der Helm et al. 2002", _mends, N_M,
          f"methods with and without a reference ({PRESET})"),
    Claim(f"The bands of kbr with a reference hold the truth in {LEAST:g} to {MOST:g} %, on average", OWN, _covers, "%",
          f"{BEST} ({PRESET})"),
    Claim(f"Where the angle is imposed a reference costs nothing (random error to within {100 * ALIKE:g} %)", OWN,
          _costs_nothing, RATIO, f"an actuator of {IMPOSED:g} N·m/rad ({PRESET})"),
    Claim(f"Weighting by the residual lowers kbr's random error under slow noise (by a factor of {GAINS:g}) and does "
          f"not raise it under wide-band noise (to within {100 * ALIKE:g} %)", OWN, _weighting, RATIO,
          f"kbr with both weightings ({PRESET})"),
)  # fmt: skip
