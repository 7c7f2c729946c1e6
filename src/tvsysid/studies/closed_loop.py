"""Joints on a compliant actuator, identified by methods with and without a reference.

The thresholds are ours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures import Illustration, coverage_over_time, method_comparison
from tvsysid.figures.results import OVER_TIME, scenario_traits, unique
from tvsysid.figures.words import count
from tvsysid.methods import CLOSED_LOOP, from_text
from tvsysid.numerics import Array
from tvsysid.simulate import SYSTEMS, CompliantActuator
from tvsysid.studies.claims import (
    HOW_DECIDED,
    RATIO,
    Claim,
    Comparison,
    Comparisons,
    Published,
    Rows,
    Scores,
    compare,
    judge_claims,
    log_ratio,
    within,
)
from tvsysid.studies.error_over import error_over
from tvsysid.study.scenarios import Scenario

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

OPEN = ("sds", "esm:stiffness=fit", "birf", "kbr", "kbr:weighting=residual")
CLOSED = CLOSED_LOOP
"""Of the methods above, in their order, but for ``kbr`` with white weighting."""
UNWEIGHTED = "kbr:reference=disturbance"
ACTUATORS = (30.0, 100.0, 300.0, 1000.0)  # N·m/rad
IMPOSED = 1e5  # N·m/rad, so stiff that the loop counts as open
SNR = {2.0: 5.0, 5.0: 5.0, 40.0: 10.0}  # dB, by the cut-off of the noise in Hz
SHORT, LONG = 40.0, 150.0  # s


def system(actuator: float, noise: float) -> str:
    """Name of the system with this actuator and noise."""
    return f"loaded:actuator_stiffness={actuator:g},noise_bandwidth={noise:g}"


PRESETS: dict[str, dict[str, object]] = {
    "closed-loop": {
        "stiffness": ("sine",),
        "perturbation": ("noise:cutoff=20",),
        "duration_s": (SHORT,),
        "snr_db": (SNR[40.0],),
        "system": tuple(system(actuator, 40.0) for actuator in (*ACTUATORS, IMPOSED)),
        "methods": (*OPEN, *CLOSED[:3], UNWEIGHTED, CLOSED[3]),
        "trials": 20,
        "subtract_mean": True,
        "also": (
            {
                "snr_db": (SNR[5.0],),
                "system": tuple(system(actuator, 5.0) for actuator in (*ACTUATORS, IMPOSED)),
            },
            {
                "snr_db": (SNR[2.0],),
                "system": tuple(system(actuator, 2.0) for actuator in ACTUATORS),
            },
            {"snr_db": (SNR[5.0],), "system": (system(100.0, 5.0),), "stiffness": ("square",)},
            {"snr_db": (SNR[5.0],), "system": (system(100.0, 5.0),), "duration_s": (LONG,)},
        ),
    }
}
"""Twenty realizations of a joint whose stiffness varies in a sine, on actuators from 30 to
1000 N·m/rad and on one that imposes the angle, with noise of the torque up to 2, 5 and 40 Hz; a
square wave, and a longer record."""

MIN_LOSS = 18.0  # N·m/rad, of 100, that slow noise costs at least without a reference
MAX_LOSS = 5.0  # N·m/rad that wide-band noise costs at most
STAYS = 0.1  # share by which the bias in a longer record may be smaller
MAX_BIAS = 1.5  # N·m/rad of kbr with a reference and weights
MAX_OTHER_BIAS = 2.5  # N·m/rad of esm and birf with a reference
COVERAGE = (90.0, 97.0)  # % of the 95 % bands
ALIKE = 0.02  # share by which a reference may make the random error larger where there is no loop
GAINS = 0.25  # share by which weighting lowers the random error at least under slow noise
COSTS = 0.06  # share by which it makes the error larger at most under wide-band noise
WHITE, WEIGHTED, BEST = OPEN[3], OPEN[4], CLOSED[3]
PLACES = tuple(product(SNR, ACTUATORS))  # noise and actuator of every sine in closed loop


def scenario(actuator: float, noise: float, duration_s: float = SHORT) -> Scenario:
    """Return the scenario of a sine wave on this actuator with this noise."""
    return Scenario(
        "sine", "noise:cutoff=20", duration_s, SNR[noise], "constant", system(actuator, noise)
    )


def judge(scores: xr.Dataset) -> pd.DataFrame:
    """Hold every claim against the scores of a study."""
    return judge_claims(CLAIMS, Scores(scores))


def _where(actuator: float, noise: float) -> str:
    return f"on {actuator:g} N·m/rad, noise up to {noise:g} Hz"


def _each(
    metric: str,
    words: str,
    methods: Sequence[str],
    noises: Iterable[float],
    margin: Callable[[Array], Array],
) -> Comparisons:
    """Compare a metric of each method in every closed loop."""
    return compare(
        [
            (
                f"{words.format(method=method)} {_where(actuator, noise)}",
                (scenario(actuator, noise), method, metric),
            )
            for method, noise, actuator in product(methods, noises, ACTUATORS)
        ],
        margin,
    )


BIAS = "mean bias of {method} {{:.1f}} N·m/rad"
COVERS = "the bands of {method} hold the truth in {{:.1f}} %"


def _within(limit: float) -> Callable[[Array], Array]:
    return lambda bias: limit - np.abs(bias)


def _random_errors(one: str, other: str, actuator: float, noise: float) -> Rows:
    """Yield the comparison of the random errors of two methods."""
    words = f"random error of {one} {{0:.1f}}, of {other} {{1:.1f}} N·m/rad"
    places = ((scenario(actuator, noise), method, "random_error") for method in (one, other))
    yield f"{words} {_where(actuator, noise)}", *places


STAYING = [
    (
        f"mean bias of {method} {{0:.1f}} N·m/rad in {LONG:g} s, {{1:.1f}} in {SHORT:g} s",
        *((scenario(100.0, 5.0, seconds), method, "mean_bias") for seconds in (LONG, SHORT)),
    )
    for method in OPEN[:4]
]
IMPOSED_ANGLE = [
    row
    for (rival, method), noise in product(
        zip((*OPEN[1:3], WEIGHTED), CLOSED[1:], strict=True), (5.0, 40.0)
    )
    for row in _random_errors(method, rival, IMPOSED, noise)
]
SLOW = [
    row
    for noise, actuator in PLACES
    if noise < 40
    for row in _random_errors(UNWEIGHTED, BEST, actuator, noise)
]
SLOW += _random_errors(WHITE, WEIGHTED, IMPOSED, 5.0)
WIDE = [
    row
    for noise, actuator in PLACES
    if noise == 40
    for row in _random_errors(UNWEIGHTED, BEST, actuator, noise)
]


def _weighting(scores: Scores) -> Iterator[Comparison]:
    """Compare the random errors without and with weights."""
    yield from compare(SLOW, lambda *pair: log_ratio(*pair) + np.log1p(-GAINS))(scores)
    yield from compare(WIDE, lambda *pair: log_ratio(*pair) + np.log1p(COSTS))(scores)


N_M, OWN, VAN_DER_HELM = "N·m/rad", "this package", "van der Helm et al. 2002"
PRESET = "the preset closed-loop"
WITHOUT = f"methods without a reference ({PRESET})"
CLAIMS: tuple[Claim, ...] = (
    Claim(
        f"Without a reference slow noise (5 Hz, 5 dB) takes over {MIN_LOSS:g} of 100 N·m/rad, "
        "whatever the actuator", "Ludvig and Kearney 2009",
        _each("mean_bias", BIAS, OPEN[:4], [5.0], lambda bias: -MIN_LOSS - bias), N_M, WITHOUT,
    ),
    Claim(
        f"A longer record does not mend it (by {100 * STAYS:g} % at most)", OWN,
        compare(
            STAYING,
            lambda late, early: log_ratio(np.abs(late), np.abs(early)) - np.log1p(-STAYS),
        ),
        RATIO, f"40 and 150 s of {WITHOUT}",
    ),
    Claim(
        f"Noise up to 40 Hz at 10 dB takes less than {MAX_LOSS:g} N·m/rad", OWN,
        _each("mean_bias", BIAS, OPEN[:4], [40.0], _within(MAX_LOSS)), N_M, WITHOUT,
    ),
    Claim(
        f"kbr with a reference and weights is off by less than {MAX_BIAS:g} N·m/rad on any "
        "actuator", VAN_DER_HELM,
        _each("mean_bias", BIAS, (BEST,), SNR, _within(MAX_BIAS)), N_M, f"{BEST} ({PRESET})",
    ),
    Claim(
        f"esm and birf with a reference are off by less than {MAX_OTHER_BIAS:g} N·m/rad on any "
        "actuator", VAN_DER_HELM,
        _each("mean_bias", BIAS, CLOSED[1:3], SNR, _within(MAX_OTHER_BIAS)), N_M,
        f"{' and '.join(CLOSED[1:3])} ({PRESET})",
    ),
    Claim(
        f"The bands of kbr with a reference and weights hold the truth in {COVERAGE[0]:g} to "
        f"{COVERAGE[1]:g} %, on any actuator", OWN,
        _each("coverage", COVERS, (BEST,), SNR, within(*COVERAGE)), "%", f"{BEST} ({PRESET})",
    ),
    Claim(
        "Those of esm and birf with a reference do so too", OWN,
        _each("coverage", COVERS, CLOSED[1:3], SNR, within(*COVERAGE)), "%",
        f"{' and '.join(CLOSED[1:3])} ({PRESET})",
    ),
    Claim(
        "Where the angle is imposed a reference costs nothing (random error to within "
        f"{100 * ALIKE:g} %)", OWN,
        compare(IMPOSED_ANGLE, lambda *pair: np.log1p(ALIKE) - log_ratio(*pair)), RATIO,
        f"an actuator of {IMPOSED:g} N·m/rad ({PRESET})",
    ),
    Claim(
        f"Weighting by the residual takes {100 * GAINS:g} % off kbr's random error under slow "
        f"noise, and adds less than {100 * COSTS:g} % under wide-band noise", OWN, _weighting,
        RATIO, f"kbr with both weightings ({PRESET})",
    ),
)  # fmt: skip

SIZE = "stiffness of the actuator (N·m/rad)"


def loop_of(label: object) -> CompliantActuator | None:
    """Return the system of this label, if it is a closed loop of the package."""
    name, _, _ = str(label).partition(":")
    usual = SYSTEMS.get(name)
    if not isinstance(usual, CompliantActuator):
        return None
    found: CompliantActuator = from_text(str(label), "system", usual)
    return found


def loop_figures(results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Illustration]:
    """Return all figures of a study, by the stem of the file's name.

    ``"bias-5Hz"``: mean bias of the stiffness against the stiffness of the actuator, for each
    noise; ``"comparison-5Hz"``: estimates over time, with bars of all scenarios of that noise;
    ``"coverage-5Hz"``: bands.

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run`, and of these results, with full names
        (:func:`tvsysid.study.by_full_name`).
    """
    traits = scenario_traits(results)
    loops = {
        label: loop
        for label, system in traits.system.items()
        if (loop := loop_of(system)) is not None
    }
    traits = traits.loc[list(loops)].assign(
        size=[loop.actuator_stiffness for loop in loops.values()],
        noise=[loop.noise_bandwidth for loop in loops.values()],
    )
    shown: dict[str, Illustration] = {}
    for noise, rows in traits.groupby("noise"):
        usual = rows[
            (rows.profile == rows.profile.iloc[0]) & (rows.duration_s == rows.duration_s.min())
        ]
        soft = usual["size"][usual["size"] < IMPOSED]
        if soft.nunique() > 1:
            what = f"noise up to {noise:g} Hz"
            title = f"Stiffness on a compliant actuator, {what}"
            text = f"Mean bias of the stiffness in N·m/rad against the {SIZE}; {what}."
            bias = error_over(summary, "mean_bias", soft, title, text, SIZE)
            shown[f"bias-{noise:g}Hz"] = bias
        middle = usual.index[len(usual) // 3]
        title = f"Open and closed methods: noise up to {noise:g} Hz"
        labels, mine = list(usual.index), summary[summary.scenario.isin(usual.index)]
        data = results[OVER_TIME].sel(
            scenario=labels, quantity=["stiffness"], method_key=unique(mine.method)
        )
        text = (
            f"A column for each method. Upper rows, over one realization of {middle}: estimated "
            "stiffness, mean and two standard deviations over "
            f"{count(results.sizes['trial'], 'trial')}, against the truth, and time-varying VAF. "
            f"Lower rows: bars of errors and VAF for {count(len(labels), 'scenario')}: "
            f"{', '.join(labels)}."
        )
        drawing = partial(method_comparison, data, mine, [middle], labels, title)
        shown[f"comparison-{noise:g}Hz"] = Illustration(drawing, title, text)
        title = f"Coverage of the 95 % bands: noise up to {noise:g} Hz"
        drawing = partial(coverage_over_time, results, [middle], title)
        text = (
            "Share of trials whose 95 % band holds the true stiffness, over a realization of "
            f"{middle}, by method."
        )
        shown[f"coverage-{noise:g}Hz"] = Illustration(drawing, title, text)
    return shown


LITERATURE = Published(
    judge,
    loop_figures,
    f"What is said of joints in closed loop, and whether this study finds it. {HOW_DECIDED}",
    tuple(PRESETS),
)


def published(results: xr.Dataset) -> Published | None:
    """Return the claims for a simulation study, if all its systems are closed loops."""
    systems = results.system.values
    return LITERATURE if all(loop_of(label) is not None for label in systems) else None
