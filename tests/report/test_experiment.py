import re

import pytest
from tests.experimental import claims, experiment_of, fail, results_of, summary_of
from tests.report.conftest import pictures
from tests.report.elements import Elements, section, table

from tvsysid.report import problems, write_experiment_report
from tvsysid.report.experiment import experiment_figures, metrics


@pytest.fixture(scope="session")
def elements(experiment_page):
    return Elements(experiment_page.read_text())


def test_figures_are_inside_in_order_with_their_descriptions(elements):
    stems = [attrs["id"] for attrs, _ in elements.of("figure")]
    assert stems == [
        "participants",
        "participant",
        "variance-and-spread",
        "error-against-truth",
        "recorded-signals",
        "preparation",
    ]
    numbers = [re.match(r"Figure (\d)\.", text).group(1) for _, text in elements.of("figcaption")]
    assert numbers == ["1", "2", "3", "4", "5", "6"]
    assert "Figure 6." in section(elements, "recordings")


def test_who_is_virtual_is_told(elements):
    # One recording of P3 failed, but the truth about P3 is known from the other.
    assert (
        "The participants are virtual: their true stiffness is known."
        in elements.of("header")[0][1]
    )


def test_outcome_tells_what_was_kept_and_found(experiment, elements):
    text = section(elements, "outcome")
    assert "6 recordings of 3 participants; 4 methods" in text
    assert "288 identifications in all, of which 54 failed." in text
    assert "With filtered noise, 260 of 300 realizations were kept on average." in text
    assert "Of 4 published claims: holds: 1" in text
    rows = experiment.summary[
        (experiment.summary.metric == "random_error") & (experiment.summary.perturbation == "prbs")
    ]
    birf = rows[(rows.method == "birf") & (rows.realizations == 75)].value
    assert (
        f"birf has the lowest random error ({birf.mean():.2f} ± {birf.std():.2f} N·m/rad)" in text
    )


def test_metrics_are_means_and_deviations_over_participants(experiment, elements):
    text = table(elements, "Metrics of each method, mean ± standard deviation over participants")
    for heading in (
        "mean stiffness (N·m/rad)",
        "VAF 1–10 Hz (%)",
        "mean bias (N·m/rad)",
        "realizations",
    ):
        assert heading in re.sub("[↕ ]+", " ", text)
    rows = experiment.summary[
        (experiment.summary.metric == "vaf")
        & (experiment.summary.method == "eirf")
        & (experiment.summary.perturbation == "noise")
        & (experiment.summary.realizations == 150)
    ].value
    assert f"{rows.mean():.2f} ± {rows.std():.2f}" in text
    assert len(metrics(experiment.summary)) == 16


def test_each_participant_by_itself(experiment, elements):
    text = table(elements, "Metrics of each method for each participant")
    rows = experiment.summary[
        (experiment.summary.metric == "vaf") & (experiment.summary.participant == "P2")
    ]
    for value in rows.value:
        assert f" {value:.2f} " in text
    assert text.count("P2") == 16
    assert "±" not in text


def test_exclusions_by_step(elements):
    text = table(elements, "What became of the realizations")
    assert "P1-noise 300 2 7 31 260" in text
    assert "P1-prbs 300 22 7 31 240" in text
    assert "P3-prbs 0 0 0 0 0" in text


def test_claims_that_were_not_studied_are_folded_away(elements):
    studied = table(elements, "What van de Ruit et al. (2021) say of their experiment")
    for verdict in ("✓ holds", "✗ does not hold", "? undecided"):
        assert verdict in studied
    assert "not studied" not in studied
    assert "A sine wave is followed with little bias." in table(
        elements, "Claims that these recordings do not bear on."
    )
    assert "1 claim not studied" in [text for _, text in elements.of("summary")]


def test_remarks_about_files(elements):
    text = section(elements, "recordings")
    assert "P2-noise trial_3.mat left out: <no torque> angle is clipped" in text
    assert len([item for _, item in elements.of("li") if item == "angle is clipped"]) == 1


def test_problems_name_the_recording_or_the_analysis(experiment, elements):
    text = section(elements, "problems")
    assert "P3-prbs failed 48 48 InputError: every file of <P3> is unreadable" in text
    assert "kbr-40 failed 6 30 P1-noise: KernelRegression: no convergence" in text
    assert "birf-75 warning 12 30 P1-noise: few realizations" in text
    assert len(problems(experiment.results)) == 3
    assert problems(results_of(("P1",), methods=("sds",))) == []


def test_draws_that_failed_in_every_analysis_are_no_failed_recording():
    results = results_of(("P1",), ("noise",), ("sds",))
    results["failure"][:, :, :2] = "no"
    found = [(each["method"], each["count"], each["trials"]) for each in problems(results)]
    assert found == [("sds-75", 2, 6), ("sds-150", 2, 6)]


def test_what_was_run_and_how_to_do_it_again(elements):
    text = section(elements, "run")
    for words in (
        "max shift 0.25",
        "reference target",
        "bootstraps 6",
        "version of numpy 2.3.1",
    ):
        assert words in text
    command, code = ("".join(texts) for tag, _, texts in elements.found if tag == "pre")
    assert command == "tvsysid experiment --virtual 3 && echo"
    assert (
        'results.estimate.sel(quantity="stiffness", recording="P1-noise", analysis="eirf-75")'
        in code
    )


@pytest.mark.parametrize("truth", [True, False])
def test_one_record_without_claims_figures_command_or_attributes(tmp_path, truth):
    one = experiment_of(
        participants=("S1",), perturbations=("steps",), methods=("sds",), amounts=(30,),
        period=1.5, truth=truth,
        target=False,
    )  # fmt: skip
    one.results.attrs = {}
    write_experiment_report(
        tmp_path / "report.html", one.results, one.summary, claims().iloc[:0], {}
    )
    elements = Elements((tmp_path / "report.html").read_text())
    text = elements.of("main")[0][1]
    assert "nan" not in text
    assert "claim" not in text
    assert "Nothing was left out, and there were no warnings." in text
    assert "6 identifications in all, of which none failed" in text
    assert ("mean bias" in text) == truth
    assert "Each participant" not in text
    header = elements.of("header")[0][1]
    assert ("The true stiffness is not known." in header) == (not truth)
    assert "standard deviation over participants" not in text


@pytest.mark.slow
@pytest.mark.usefixtures("sketched")
def test_when_everything_failed(tmp_path):
    made = experiment_of(methods=("sds", "esm"))
    failed = fail(made.results, "InputError: nothing to read")
    summary = summary_of(failed)
    figures = pictures(experiment_figures(failed, summary, []))
    write_experiment_report(tmp_path / "report.html", failed, summary, claims(), figures)
    text = Elements((tmp_path / "report.html").read_text()).of("main")[0][1]
    assert "nan" not in text
    assert "144 identifications in all, of which 144 failed" in text
