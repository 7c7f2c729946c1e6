import pytest
from tests.drawing import draw
from tests.synthetic import SINE, SQUARE, results_of, summary_of

from tvsysid.studies.van_de_ruit_2021 import STUDY


@pytest.mark.slow
def test_all_figures_of_a_study():
    results = results_of(methods=("sds", "kbr"))
    shown = STUDY.figures(results, summary_of(results))
    assert list(shown) == [
        "comparison-square-noise", "comparison-square-prbs",
        "comparison-sine-noise", "comparison-sine-prbs", "impulse-responses",
    ]  # fmt: skip
    for illustration in shown.values():
        figure = illustration.draw()
        draw(figure)
        assert figure.get_suptitle().replace("\n", " ") == illustration.title
        assert illustration.description.endswith(".")


def test_descriptions_say_what_is_drawn(results, summary):
    text = STUDY.figures(results, summary)["comparison-square-prbs"].description
    assert "over one realization of square-prbs-150s-10dB" in text


NOISES = [("constant", "noise", 40.0, snr) for snr in (0.0, 10.0, float("inf"))]


@pytest.mark.parametrize(
    ("scenarios", "stems"),
    [
        (SQUARE[:2], ["square-noise", "impulse-responses"]),
        (SINE[1:], ["sine-prbs"]),
        (NOISES, ["constant-noise"]),
    ],
)
def test_what_a_study_has_decides_on_its_figures(scenarios, stems):
    results = results_of(scenarios, ("sds", "esm"), trials=2)
    first, *others = stems
    expected = [f"comparison-{first}", *others]
    assert list(STUDY.figures(results, summary_of(results))) == expected


@pytest.mark.slow
def test_one_perturbation_and_several_noises_are_drawn():
    results = results_of(NOISES, ("sds", "esm"), trials=2)
    for illustration in STUDY.figures(results, summary_of(results)).values():
        draw(illustration.draw())


def test_covarying_viscosity_has_figures_of_its_own():
    results = results_of(SINE, ("sds", "esm"), trials=2, viscosity="covarying")
    shown = STUDY.figures(results, summary_of(results))
    assert list(shown) == [f"comparison-sine-covarying-{p}" for p in ("noise", "prbs")]
    for each in shown.values():
        assert "viscosity that varies with stiffness" in each.title
