import json
import tomllib

import numpy as np
import pytest
from tests.report.conftest import HOSTILE
from tests.report.elements import Elements, section, table
from tests.synthetic import claims, results_of, summary_of

from tvsysid.figures.results import scenario_traits
from tvsysid.report import write_report
from tvsysid.report.page import in_text
from tvsysid.report.studies import best_methods
from tvsysid.report.study import main_scenario, toml_of


@pytest.fixture(scope="session")
def elements(page):
    elements = Elements(page.read_text())
    assert elements.open == []
    return elements


def test_hostile_labels_are_only_text(elements):
    assert f"{HOSTILE} This is your own method" in section(elements, "methods")


def test_ranking_has_every_method_in_every_scenario(elements, study):
    results, summary = study
    rows = [attrs for attrs, _ in elements.of("tr") if "data-group" in attrs]
    assert len(rows) == results.sizes["scenario"] * results.sizes["method_key"]
    text = table(elements, "Metrics of each method")
    for heading in (
        "bias error (N·m/rad)",
        "rise time (s)",
        "VAF 1–10 Hz (%)",
        "in 95 % band (%)",
        "time (ms)",
    ):
        assert heading in text
    row = summary[
        (summary.scenario == "square-noise-40s-10dB") & (summary.method == "eirf")
    ].set_index("metric")
    assert f"{row.value.bias_error:.2f} ± {row.standard_error.bias_error:.2f}" in text
    assert f"{1000 * row.value.seconds:.1f}" in text


def test_claims_with_verdicts_in_words_and_symbols(elements):
    text = table(elements, "What is published")
    for verdict in ("✓ holds", "✗ does not hold", "? undecided", "– not studied"):
        assert verdict in text
    assert "82 84.2" in text
    assert "−0.200 0.400" in text
    assert "Add the sine profile to the study." in text
    assert "nan" not in text


def test_assumptions_failures_and_warnings(elements):
    assert "sds:window=0.2: Short data segments" in section(elements, "methods")
    assert "The movement is the same in all realizations." in section(elements, "methods")
    text = section(elements, "problems")
    reason = "square-noise-40s-10dB: KernelRegression: the record is <too short>"
    assert f"kbr failed 9 9 {reason}" in text
    assert "eirf warning 2 9 square-noise-40s-10dB: few realizations" in text


def test_what_was_run_can_be_run_again(elements):
    command, code = ("".join(texts) for tag, _, texts in elements.found if tag == "pre")
    assert command == "tvsysid benchmark --trials 3 && echo"
    assert 'xr.open_dataset("results.nc")' in code
    assert "trials 3" in table(elements, "Settings of the study")


def test_no_file_is_shown_that_could_not_name_an_object(study):
    settings = json.loads(study[0].attrs["study"]) | {"methods": ["sds:window=0.2"]}
    assert tomllib.loads(toml_of(settings)) == settings
    for objects in (
        {"stiffness": ["SquareWave(low=60.0)"]},
        {"also": [{"system": ["Mine"]}]},
        {"methods": ["Mine"]},  # an object without a repr of its own
    ):
        assert toml_of(settings | objects) == ""


def test_outcome_says_who_is_best_and_how_surely(study, elements):
    results, summary = study
    label = main_scenario(scenario_traits(results))
    rows = summary[(summary.scenario == label) & (summary.metric == "bias_error")]
    best = rows.loc[rows.value.idxmin()]
    text = section(elements, "outcome")
    assert (
        f"{best.method} has the lowest bias error ({best.value:.2f} ± {best.standard_error:.2f} "
        "N·m/rad)" in text
    )
    assert "Lowest total error: " in text
    assert (
        "Of 4 published claims: holds: 1, does not hold: 1, undecided: 1, not studied: 1." in text
    )


def test_small_differences_are_not_called_clear():
    summary = summary_of(results_of([("square", "noise", 150.0, 10.0)], ("sds", "esm"), 2))
    summary.loc[summary.metric == "vaf", "value"] = [97.1, 97.2]
    summary.loc[summary.metric == "vaf", "standard_error"] = 0.5
    last = best_methods(summary)[-1]
    assert [last[name] for name in ("method", "words", "rival")] == ["esm", "highest VAF", "sds"]


def test_one_trial_without_claims_figures_command_or_attributes(tmp_path):
    results = results_of([("constant", "prbs", 40.0, np.inf)], ("esm",), trials=1)
    results.attrs = {}
    write_report(tmp_path / "report.html", results, summary_of(results), claims().iloc[:0], {})
    elements = Elements((tmp_path / "report.html").read_text())
    assert "No claim was examined." in elements.of("main")[0][1]
    assert "1 scenario with 1 trial each" in elements.of("main")[0][1]
    assert "nan" not in elements.of("main")[0][1]
    assert [text for _, text in elements.of("h3")] == ["esm: Ensemble spectral method"]


def test_numbers_and_settings_as_text():
    assert [in_text(9.8765, 0.1234, 2), in_text(1234.5)] == ["9.88 ±\xa00.12", "1230"]
