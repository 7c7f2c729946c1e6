import pytest
from tests.drawing import draw
from tests.experimental import experiment_of, fail, prepared_of, results_of, summary_of
from tests.virtual import prepared

from tvsysid.report.experiment import experiment_figures, representative

ALL = [
    "participants",
    "participant",
    "variance-and-spread",
    "error-against-truth",
    "recorded-signals",
    "preparation",
]


@pytest.fixture(scope="module")
def shown(experiment):
    recordings = prepared_of(experiment.results, prepared(1, "prbs"))
    return experiment_figures(experiment.results, experiment.summary, recordings)


@pytest.mark.slow
def test_all_figures_of_an_experiment():
    few = experiment_of(participants=("P1", "P2"), methods=("sds", "kbr"))
    recordings = prepared_of(few.results, prepared(1, "prbs"))
    shown = experiment_figures(few.results, few.summary, recordings)
    assert list(shown) == ALL
    for each in shown.values():
        figure = each.draw()
        draw(figure)
        assert figure.get_suptitle() == each.title
        assert each.description.endswith(".")
        assert "nan" not in each.description


def test_the_participant_in_the_middle_stands_for_all(experiment, shown):
    # VAF rises with the participant's number
    assert representative(experiment.results) == "P2"
    assert shown["participant"].title == "Participant P2 in detail"
    assert shown["recorded-signals"].title == "What was recorded from P2"
    assert shown["preparation"].title == "Preparation of P2-noise"


def test_who_is_incomplete_does_not_stand_for_all(experiment):
    failed = fail(experiment.results.copy(deep=True), "no", recording="P2-noise")
    assert representative(failed) in ("P1", "P3")


def test_descriptions_say_what_is_drawn(shown):
    assert "mean and two standard deviations over bootstraps" in shown["participant"].description
    assert "esm, 75 × 2 s; kbr, 20 × 2 s" in shown["participants"].description


@pytest.mark.slow
def test_a_single_record_of_walking():
    one = experiment_of(
        participants=("S1",),
        perturbations=("steps",),
        amounts=(30,),
        period=1.5,
        truth=False,
        target=False,
    )
    shown = experiment_figures(one.results, one.summary, [])
    assert list(shown) == ["participants", "participant", "variance-and-spread"]
    for each in shown.values():
        draw(each.draw())
    assert "30 × 1.5 s" in shown["participants"].description


@pytest.mark.slow
def test_when_everything_failed():
    failed = fail(results_of(("P1", "P2"), methods=("sds",)), "no")
    shown = experiment_figures(failed, summary_of(failed), [])
    for each in shown.values():
        draw(each.draw())
        assert "nan" not in each.description
    assert list(shown) == ["participants", "participant", "variance-and-spread"]
