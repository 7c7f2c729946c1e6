import pytest
from tests.drawing import draw
from tests.synthetic import SINE, SQUARE, responses_of, results_of, summary_of

from tvsysid.studies.van_de_ruit_2021.figures import study_figures


@pytest.mark.slow
def test_all_figures_of_a_study():
    results = results_of(methods=("sds", "kbr"))
    shown = study_figures(results, summary_of(results), responses_of())
    assert list(shown) == [
        "comparison-square-noise", "comparison-square-prbs", "amount-square", "coverage-square",
        "comparison-sine",
        "coverage-sine", "impulse-responses",
    ]  # fmt: skip
    for illustration in shown.values():
        figure = illustration.draw()
        draw(figure)
        assert figure.get_suptitle() == illustration.title
        assert illustration.description.endswith(".")


def test_descriptions_say_what_is_drawn(results, summary):
    text = study_figures(results, summary)["comparison-square-prbs"].description
    assert "over one realization of square-prbs-150s-10dB" in text
    assert "mean and two standard deviations over 6 trials" in text


NOISES = [("constant", "noise", 40.0, snr) for snr in (0.0, 10.0, float("inf"))]


@pytest.mark.parametrize(
    ("scenarios", "stems"),
    [
        (SQUARE[:2], ["comparison-square-noise", "amount-square", "coverage-square"]),
        (SINE[1:], ["comparison-sine-prbs", "coverage-sine"]),
        (NOISES, ["comparison-constant-noise", "amount-constant-snr", "coverage-constant"]),
        (
            [
                ("square", "noise", duration, snr)
                for duration in (40.0, 80.0)
                for snr in (0.0, 10.0)
            ],
            ["comparison-square-noise", "amount-square", "amount-square-snr", "coverage-square"],
        ),
    ],
)
def test_what_a_study_has_decides_on_its_figures(scenarios, stems):
    results = results_of(scenarios, ("sds", "esm"), trials=2)
    assert list(study_figures(results, summary_of(results))) == stems


@pytest.mark.slow
def test_one_perturbation_and_several_noises_are_drawn():
    results = results_of(NOISES, ("sds", "esm"), trials=2)
    for illustration in study_figures(results, summary_of(results)).values():
        draw(illustration.draw())


def test_covarying_viscosity_has_figures_of_its_own():
    results = results_of(SINE, ("sds", "esm"), trials=2, viscosity="covarying")
    shown = study_figures(results, summary_of(results))
    assert list(shown) == ["comparison-sine-covarying", "coverage-sine-covarying"]
    assert all(
        "viscosity varies with stiffness" in illustration.title for illustration in shown.values()
    )
