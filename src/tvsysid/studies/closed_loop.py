"""Joints on a compliant actuator, identified by methods with and without a reference.

The thresholds are ours.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures import Illustration
from tvsysid.figures.results import scenario_traits
from tvsysid.methods import CLOSED_LOOP, resolve
from tvsysid.simulate import SYSTEMS, CompliantActuator
from tvsysid.studies.claims import HOW_DECIDED, Claim, Margin, ratio
from tvsysid.studies.pictures import comparison, coverage, error_over_size
from tvsysid.studies.published_study import PublishedStudy
from tvsysid.study.scenarios import Scenario

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

OPEN = ("sds", "esm:stiffness=fit", "birf", "kbr", "kbr:weighting=residual")
UNWEIGHTED = "kbr:reference=disturbance"
WHITE, WEIGHTED = OPEN[3:]
*_, BIRF, BEST = CLOSED_LOOP
ACTUATORS = (30.0, 100.0, 300.0, 1000.0)  # N·m/rad
IMPOSED = 1e5  # N·m/rad, so stiff that the loop counts as open
SNR = {2.0: 5.0, 5.0: 5.0, 40.0: 10.0}  # dB, by the cut-off of the noise in Hz
SHORT, LONG = 40.0, 150.0  # s


def system(actuator: float, noise: float) -> str:
    """Return the name of the system with this actuator and noise."""
    return f"loaded:actuator_stiffness={actuator:g},noise_bandwidth={noise:g}"


def scenario(actuator: float, noise: float, duration_s: float = SHORT) -> Scenario:
    """Return the scenario of a sine wave on this actuator with this noise."""
    return Scenario(
        "sine", "noise:cutoff=20", duration_s, SNR[noise], "constant", system(actuator, noise)
    )


def loops(noises: Iterable[float], actuators: Iterable[float] = ACTUATORS) -> list[str]:
    """Return the labels of scenarios with these noises and actuators."""
    return [scenario(actuator, noise).label for noise in noises for actuator in actuators]


def _grid(noise: float, *actuators: float, **settings: object) -> dict[str, object]:
    """Return the settings of sines with this noise, on these actuators."""
    systems = tuple(system(actuator, noise) for actuator in actuators)
    return {"snr_db": (SNR[noise],), "system": systems, **settings}


PRESETS = {
    "closed-loop": {
        "stiffness": ("sine",),
        "perturbation": ("noise:cutoff=20",),
        "duration_s": (SHORT,),
        "methods": (*OPEN, BIRF, UNWEIGHTED, BEST),
        "trials": 20,
        "subtract_mean": True,
        **_grid(40.0, *ACTUATORS, IMPOSED),
        "also": (
            _grid(5.0, *ACTUATORS, IMPOSED),
            _grid(2.0, *ACTUATORS),
            _grid(5.0, 100.0, stiffness=("square",)),
            _grid(5.0, 100.0, duration_s=(LONG,)),
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
MAX_OTHER_BIAS = 2.5  # N·m/rad of birf with a reference
COVERAGE = (90.0, 97.0)  # % of the 95 % bands
ALIKE = 0.02  # share by which a reference may make the random error larger where there is no loop
GAINS = 0.25  # share by which weighting lowers the random error at least under slow noise
COSTS = 0.06  # share by which it makes the error larger at most under wide-band noise
OWN, VAN_DER_HELM, PRESET = "this package", "van der Helm et al. 2002", "the preset closed-loop"
WITHOUT = f"methods without a reference ({PRESET})"
WITH_BEST, WITH_BIRF = (f"{each} ({PRESET})" for each in (BEST, BIRF))
BIAS, RANDOM = "mean_bias", "random_error"
CLAIMS: tuple[Claim, ...] = (
    Claim(
        f"Without a reference slow noise (5 Hz, 5 dB) takes over {MIN_LOSS:g} of 100 N·m/rad, "
        "whatever the actuator", "Ludvig and Kearney 2009", WITHOUT,
        [(Margin(high=-MIN_LOSS), BIAS, OPEN[:4], loops([5.0]))],
    ),
    Claim(
        f"A longer record does not mend it (by {100 * STAYS:g} % at most)", OWN,
        f"40 and 150 s of {WITHOUT}",
        [(
            ratio(1 - STAYS), BIAS, OPEN[:4],
            [tuple(scenario(100.0, 5.0, seconds).label for seconds in (LONG, SHORT))],
        )],
    ),
    Claim(
        f"Noise up to 40 Hz at 10 dB takes less than {MAX_LOSS:g} N·m/rad", OWN, WITHOUT,
        [(Margin(high=MAX_LOSS, of=np.abs), BIAS, OPEN[:4], loops([40.0]))],
    ),
    Claim(
        f"kbr with a reference and weights is off by less than {MAX_BIAS:g} N·m/rad on any "
        "actuator", VAN_DER_HELM, WITH_BEST,
        [(Margin(high=MAX_BIAS, of=np.abs), BIAS, BEST, loops(SNR))],
    ),
    Claim(
        f"birf with a reference is off by less than {MAX_OTHER_BIAS:g} N·m/rad on any actuator",
        VAN_DER_HELM, WITH_BIRF,
        [(Margin(high=MAX_OTHER_BIAS, of=np.abs), BIAS, BIRF, loops(SNR))],
    ),
    Claim(
        f"The bands of kbr with a reference and weights hold the truth in {COVERAGE[0]:g} to "
        f"{COVERAGE[1]:g} %, on any actuator", OWN, WITH_BEST,
        [(Margin(*COVERAGE), "coverage", BEST, loops(SNR))],
    ),
    Claim(
        f"Those of birf with a reference hold it in {COVERAGE[0]:g} % or more", OWN, WITH_BIRF,
        [(Margin(COVERAGE[0]), "coverage", BIRF, loops(SNR))],
    ),
    Claim(
        "Where the angle is imposed a reference costs nothing (random error to within "
        f"{100 * ALIKE:g} %)", OWN, f"an actuator of {IMPOSED:g} N·m/rad ({PRESET})",
        [(
            ratio(high=1 + ALIKE), RANDOM,
            [(BIRF, OPEN[2]), (BEST, WEIGHTED)],
            loops([5.0, 40.0], [IMPOSED]),
        )],
    ),
    Claim(
        f"Weighting by the residual takes {100 * GAINS:g} % off kbr's random error under slow "
        f"noise, and adds less than {100 * COSTS:g} % under wide-band noise", OWN,
        f"kbr with both weightings ({PRESET})",
        [
            (ratio(1 / (1 - GAINS)), RANDOM, [(UNWEIGHTED, BEST)], loops([2.0, 5.0])),
            (ratio(1 / (1 - GAINS)), RANDOM, [(WHITE, WEIGHTED)], loops([5.0], [IMPOSED])),
            (ratio(1 / (1 + COSTS)), RANDOM, [(UNWEIGHTED, BEST)], loops([40.0])),
        ],
    ),
)  # fmt: skip

SIZE = "stiffness of the actuator (N·m/rad)"


def loop_of(label: object) -> CompliantActuator | None:
    """Return the system of this label, if it is a closed loop of the package."""
    usual = SYSTEMS.get(str(label).partition(":")[0])
    return resolve(label, SYSTEMS, "system") if isinstance(usual, CompliantActuator) else None


def loop_figures(results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Illustration]:
    """Return all figures of a study, by the stem of the file's name.

    For each noise ``"bias-5Hz"``: mean bias of the stiffness against the stiffness of the actuator;
    ``"comparison-5Hz"``: estimates over time, with bars of all scenarios of that noise;
    ``"coverage-5Hz"``: bands.

    Parameters
    ----------
    results, summary
        As of :func:`tvsysid.study.run` and, of these results, :func:`tvsysid.study.summarize`.
    """
    traits = scenario_traits(results)
    loops = [loop for each in traits.system if (loop := loop_of(each))]
    traits = traits.assign(
        size=[loop.actuator_stiffness for loop in loops],
        noise=[loop.noise_bandwidth for loop in loops],
    )
    shown: dict[str, Illustration] = {}
    for noise, every in traits.groupby("noise"):
        what = f"noise up to {noise:g} Hz"
        first = every[every.profile == every.profile.iloc[0]]
        rows = first[first.duration_s == every.duration_s.min()]
        soft = rows["size"][rows["size"] < IMPOSED]
        if soft.nunique() > 1:
            shown[f"bias-{noise:g}Hz"] = error_over_size(
                summary, "mean_bias", soft, f"Stiffness on a compliant actuator, {what}", SIZE
            )
        middle = [str(rows.index[len(rows) // 3])]
        shown[f"comparison-{noise:g}Hz"] = comparison(
            results, summary, middle, list(rows.index), f"Open and closed methods: {what}"
        )
        shown[f"coverage-{noise:g}Hz"] = coverage(
            results, middle, f"Coverage of the 95 % bands: {what}"
        )
    return shown


STUDY = PublishedStudy(
    PRESETS,
    CLAIMS,
    f"What is said of joints in closed loop, and whether this study finds it. {HOW_DECIDED}",
    loop_figures,
    lambda results: all(loop_of(label) is not None for label in results.system.values),
)
