"""Claims about reflexes and closed loops against invented numbers; and studies of them, drawn."""

from types import SimpleNamespace

import numpy as np
import pytest
from tests.contracts.toys import Cascade
from tests.synthetic import scores_of

from tvsysid import studies
from tvsysid.studies import closed_loop, reflex, van_de_ruit_2021
from tvsysid.studies.closed_loop import (
    BEST,
    BIRF,
    ESM,
    OPEN,
)
from tvsysid.studies.reflex import FEW, GAIN, GAINS, LOUD, MANY, NAMES, NO_GAIN, SINE
from tvsysid.study import Study, run, score, summarize

LOOPS = [each for each in studies.preset("closed-loop").scenarios if each.label in closed_loop.ALL]
SLOW = LOOPS[4:5]  # on 30 N·m/rad, noise up to 5 Hz
BY_LABEL = {scenario.label: scenario for scenario in studies.preset("reflex").scenarios}
REFLEXES = [BY_LABEL[label] for label in (SINE, NO_GAIN, *GAINS, LOUD, *FEW, MANY)]
AMOUNTS = REFLEXES[-3:]


def of_loops(place, method, metric):
    """Numbers that fulfil every claim about closed loops."""
    slow = "noise_bandwidth=40" not in place.system
    return (-24.0 if slow else -2.0) if method in OPEN else 0.5


def of_reflexes(place, method, metric):
    """Numbers that fulfil every claim about reflexes."""
    gain = dict(zip((NO_GAIN, *GAINS), NAMES, strict=True)).get(place.label, 8.0)
    if metric == "mean_bias":
        return 2.0 * gain + 0.5 if method in reflex.ONE_PATH else 0.1
    if metric == "total_error":
        return {"sdss": 5.0, "pc": 9.0}.get(method, 6.0)
    if place in AMOUNTS:
        return {200.0: 4.0, 600.0: 3.0, 1200.0: 1.0}[place.duration_s]
    return {"sdss": 1.0, "pc": 2.0, "cascade": 0.1}.get(method, 1.5)


LITERATURE = {
    "loops": SimpleNamespace(
        study=closed_loop.STUDY, numbers=of_loops, scenarios=LOOPS, spread=0.002,
        methods=(*OPEN, ESM, BIRF, BEST), metrics=("mean_bias",),
    ),
    "reflexes": SimpleNamespace(
        study=reflex.STUDY, numbers=of_reflexes, scenarios=REFLEXES, spread=0.02,
        methods=(*reflex.ONE_PATH, *reflex.TWO_PATHS, "tvpc:window=0"),
        metrics=("mean_bias", "total_error", GAIN),
    ),
}  # fmt: skip


def verdicts(of, numbers=None, scenarios=(), trials=10):
    scores = scores_of(
        numbers or of.numbers, scenarios or of.scenarios, of.methods, of.metrics, of.spread, trials
    )
    return of.study.judge(scores).set_index("claim").verdict


@pytest.mark.parametrize("of", LITERATURE.values(), ids=LITERATURE)
def test_claims_hold_where_numbers_are_as_claimed(of):
    assert set(verdicts(of)) == {"holds"}
    assert set(verdicts(of, trials=5)) == {"undecided"}
    other = of.scenarios[0]._replace(perturbation="other")
    assert set(verdicts(of, scenarios=[other])) == {"not studied"}


@pytest.mark.parametrize(
    ("of", "method", "metric", "value", "where", "claim"),
    [
        ("loops", "sds", "mean_bias", -9.0, SLOW, "Without a reference slow noise"),
        ("loops", BEST, "mean_bias", -2.0, SLOW, "kbr with a reference and weights is off"),
        ("loops", BIRF, "mean_bias", -3.0, SLOW, "esm and birf with a reference are off"),
        ("reflexes", "birf", "mean_bias", -7.5, REFLEXES[2:3], "Methods of one pathway take"),
        ("reflexes", "kbr", "mean_bias", 60.0, REFLEXES[4:5], "They do so in proportion"),
        ("reflexes", "bpc", "mean_bias", 9.0, REFLEXES, "Methods of two pathways are free of it"),
        ("reflexes", "tvpc:window=0", GAIN, 1.0, AMOUNTS[:1], "tvpc needs 500 to 800 realizations"),
        ("reflexes", "bpc", GAIN, 3.0, REFLEXES[:1], "Forty cycles suffice for bpc: r"),
        ("reflexes", "bpc", "total_error", 30.0, REFLEXES[:1], "Forty cycles suffice for bpc: s"),
        ("reflexes", "sdss", "total_error", 30.0, REFLEXES[5:6], "With much noise (0 dB)"),
    ],
)
def test_one_number_against_a_claim_is_enough(of, method, metric, value, where, claim):
    of = LITERATURE[of]

    def numbers(place, *what):
        is_changed = what == (method, metric) and place in where
        return value if is_changed else of.numbers(place, *what)

    table = verdicts(of, numbers)
    (wrong,) = table.index[table == "does not hold"]
    assert wrong.startswith(claim)


def run_preset(name, **settings):
    """Run a study that has some settings of a preset; return its results, summary and figures."""
    preset = studies.PRESETS[name]
    given = {name: preset[name] for name in ("stiffness", "perturbation", "subtract_mean")}
    results = run(Study(**given, **settings), workers=1)
    summary = summarize(score(results))
    return results, summary, studies.published(results).figures(results, summary)


def ticks(figure):
    return [float(tick.get_text()) for tick in figure.axes[0].get_xticklabels()]


@pytest.mark.slow
def test_a_study_of_loops_is_drawn():
    systems = [each.system for each in LOOPS[:2]]
    results, _, shown = run_preset(
        "closed-loop", system=systems, duration_s=20, trials=2, methods=["birf", BIRF]
    )
    assert studies.published(results) is closed_loop.STUDY
    assert list(shown) == ["comparison-40Hz", "bias-40Hz"]
    assert ticks(shown["bias-40Hz"].draw()) == [30, 100]
    assert shown["comparison-40Hz"].draw().axes[0].lines


@pytest.fixture(scope="module")
def with_reflex():
    systems = ["reflex-sine", "reflex-sine:noise_bandwidth=1"]
    systems += [NAMES[gain] for gain in (0.0, 4.0, 16.0)]
    return run_preset(
        "reflex", system=systems, methods=["birf", Cascade()], duration_s=20, trials=2
    )


@pytest.mark.slow
def test_a_study_is_held_against_what_was_published_of_it(with_reflex):
    results, *_ = with_reflex
    assert studies.published(results) is reflex.STUDY
    joint = results.assign_coords(system=("scenario", ["joint"] * 5))
    assert studies.published(joint) is van_de_ruit_2021.STUDY


@pytest.mark.slow
def test_both_pathways_are_drawn_with_their_truth(with_reflex):
    results, summary, shown = with_reflex
    # One of the 5 scenarios has no reflex
    assert np.isfinite(summary.value[summary.metric == "reflex pathway_vaf"]).sum() == 4
    assert {"comparison-reflex-sine", "bias-reflex-sine"} < set(shown)
    assert "bias-reflex-sine-sine" not in shown  # both systems have the same gain
    figure = shown["comparison-reflex-sine-sine"].draw()
    rows = {axes.get_ylabel().partition("\n")[0]: axes for axes in figure.axes if axes.get_ylabel()}
    assert {"stiffness", "reflex gain", "error of gain", "VAF intrinsic", "VAF reflex"} <= set(rows)
    truth = rows["reflex gain"].lines[0].get_ydata()
    np.testing.assert_allclose(truth, results.truth.sel(quantity="reflex_gain")[0], atol=1e-9)
    labels = [label.get_text() for label in rows["VAF reflex"].get_xticklabels()]
    assert "noise bandwidth=1" in labels[1]
    assert ticks(shown["bias-reflex-sine"].draw()) == [0, 4, 16]
