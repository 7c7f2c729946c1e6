"""The page of one identification."""

import math
import re

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of, realizations
from tests.report.elements import Elements, section, table

import tvsysid as tv
from tvsysid.methods import METHODS
from tvsysid.methods.references import REFERENCES
from tvsysid.quality import Finding
from tvsysid.report.identification import methods_bibliography, methods_paragraph
from tvsysid.report.page import typeset


@pytest.fixture(scope="module")
def elements(identification_page):
    return Elements(identification_page.read_text())


def test_the_answer_comes_first_with_its_reason(elements):
    told = section(elements, "outcome")
    assert told.startswith("The stiffness to report Recommended (adaptive): stiffness ")
    assert re.search(r"Switch at 0\.\d+ s: \+\d+\.\d ± \d\.\d N·m/rad", told)
    rows = table(elements, "By adaptive: mean, lowest")
    assert "stiffness N·m/rad" in rows
    assert "inertia kg·m² 0.0" in rows
    assert "stiffness 0.499 0.4" in table(elements, "Sudden changes")


def test_it_says_how_it_was_found_and_what_is_wrong(elements):
    told = table(elements, "Where the data come from")
    for text in (
        "file <ankle>.mat",
        "recorded at 1000 Hz",
        "identified at 100 Hz",
        "realizations 60 of 2 s, from 1 trial",
    ):
        assert text in told
    assert "realizations left out 2: no context" in told
    diagnosis = section(elements, "diagnosis")
    assert "No fault found (" in diagnosis
    assert "Not judged: mean-torque" in diagnosis


def test_methods_stand_side_by_side_with_the_vaf_of_realizations_held_out(elements, identified):
    told = table(elements, "Stiffness, inertia and VAF by each method")
    for label in ("sds", "eirf"):
        inside, outside = identified.vaf[label].mean(), identified.answer.vaf[label]
        assert re.search(rf"{label} .* {inside:.1f} {outside:.1f}", told)
    assert told.endswith(" –none")  # that of adaptive is not known here
    why = table(elements, "Why the methods’ stiffness differs")
    assert "max_lag=0.12, window=0.1 It is a mean over its window" in why
    assert "This is your own method" not in why


def test_a_paragraph_is_ready_to_paste(elements, identified):
    told = methods_paragraph(identified)
    assert told in section(elements, "paragraph")
    turned = methods_paragraph(
        identified, ["the torque's sign was reversed", "degrees became radians"]
    )
    assert (
        "When the file was read, the torque's sign was reversed and degrees became radians. "
        in turned
    )
    assert f"version {tv.__version__}" in told
    assert (
        "Angle and torque, recorded at 1000 Hz in 1 trial, low-pass filtered and decimated to 100 "
        "Hz, were cut into 60 realizations of 2 s with 0.5 s of context on either side; 2 "
        "realizations too near the ends" in told
    )
    assert (
        "short data segments (sds: max_lag=0.12, window=0.1; Ludvig and Perreault, 2012; van de "
        "Ruit et al., 2021)" in told
    )
    entries = methods_bibliography(identified)
    assert re.findall(r"^@\w+\{(\w+),$", entries, re.MULTILINE) == [
        *("tvsysid", "vanderuit2021", "macneil1992", "ludvig2012"),
    ]
    assert entries.count("{") == entries.count("}")


def test_it_says_what_was_typed(identification_page):
    assert "tvsysid identify ankle.mat &amp;&amp; echo" in identification_page.read_text()


def test_every_method_says_how_its_stiffness_differs_and_cites_what_there_is():
    for key, method in METHODS.items():
        assert method.differs.endswith("."), key
        assert set(method.cites) <= set(REFERENCES), key
    assert {key for method in METHODS.values() for key in method.cites} | {"tvsysid"} == set(
        REFERENCES
    )


def test_options_stay_as_they_are_typed_and_numbers_have_one_minus_sign():
    assert typeset(
        "by -1.5 ± 2, -20 % or p = 1e-5, 3-4: --torque-sign -1, torque_sign=-1, sub-9"
    ) == ("by −1.5 ±\u00a02, −20\u00a0% or p = 1e-5, 3-4: --torque-sign -1, torque_sign=-1, sub-9")


@pytest.mark.filterwarnings("ignore::tvsysid.errors.DataQualityWarning")
def test_what_follows_a_variable_comes_first_and_an_impossible_sign_is_said(tmp_path):
    simulation = tv.simulate.ScheduledJoint().simulate(
        20, perturbation=tv.simulate.PRBS(), snr_db=10, seed=1
    )
    (variable,) = simulation.recording.channels
    recording = attrs.evolve(simulation.recording, torque=-simulation.recording.torque)
    whole = tv.preprocess.segment(tv.preprocess.decimate(recording, 100, sharp=True), None)
    whole = attrs.evolve(whole, channels={"scheduling": whole.channels[variable]})
    reversed_sign = tv.compare(whole, ["lpvkbi"])
    (told,) = reversed_sign.answer.lines
    assert told.startswith("no stiffness is stated. The torque has the opposite sign: ")
    assert "--torque-sign -1" in told
    turned = tv.compare(attrs.evolve(whole, torque=-whole.torque), ["lpvkbi"])
    over, along = turned.answer.lines
    assert over.startswith("recommended (lpvkbi): stiffness over scheduling: ")
    assert along.startswith("over time: ")
    # The method's own cross-validation over fifths of the record
    assert 80 < turned.answer.vaf["lpvkbi"] < 100
    assert "in fifths of the record that it was not identified from, and" in methods_paragraph(
        turned
    )


@pytest.mark.slow
@pytest.mark.usefixtures("sketched")
def test_a_wrong_period_is_said_with_the_answer_and_no_method_is_recommended(tmp_path):
    ensemble = ensemble_of(80.0, "square", "prbs", seed=1, period=1.9)  # of a movement of 2 s
    found = tv.compare(tv.preprocess.subtract_mean(ensemble), ["sds", "birf"])
    (told,) = found.answer.lines
    assert told.startswith("no stiffness is stated. The movement does not repeat with this period")
    assert "with a period of 2 s, beside what repeats every 1.9 s. Cut with the period" in told
    tv.report.write_identification(tmp_path / "report.html", found)
    page = Elements((tmp_path / "report.html").read_text())
    assert section(page, "outcome").startswith(
        "No stiffness is stated No stiffness is stated. The movement does not"
    )
    assert table(
        page, "Not valid, for the reasons above: stiffness, inertia and VAF by each method"
    )
    for claim in (
        "should lie in the band",
        "recommended",
        "What to report",
        "methods section of a paper",
    ):
        assert claim not in (tmp_path / "report.html").read_text()
    assert found.recommendation.suited == ()
    assert str(found).startswith("no stiffness is stated. The movement does not repeat with this ")


@pytest.mark.slow
@pytest.mark.usefixtures("sketched")
def test_what_is_said_of_a_doubtful_stiffness(tmp_path, identified):
    diagnosis = identified.recommendation.diagnosis
    drift = Finding("drift", math.inf, "stiffness drifts")
    found = attrs.evolve(
        identified, diagnosis=attrs.evolve(diagnosis, checks=(*diagnosis.checks, drift))
    )
    first, doubt, *_ = found.answer.lines
    assert first.startswith("doubtful (adaptive): stiffness ")
    assert doubt.startswith("Stiffness drifts over the experiment: stiffness drifts. ")
    tv.report.write_identification(tmp_path / "report.html", found)
    told = Elements((tmp_path / "report.html").read_text())
    assert "identify the parts of the experiment" in section(told, "outcome").lower()
    assert "recommended" not in section(told, "outcome")
    assert "This stiffness is doubtful." in methods_paragraph(found)


@pytest.mark.parametrize(
    ("shown", "text"),
    [
        (1.0, "This stiffness is the intrinsic one"),
        (0.0, "show no stretch reflex, and this stiffness is that of a joint without one"),
    ],
)
def test_the_paragraph_says_whether_there_is_a_reflex(identified, shown, text):
    model = identified.models["adaptive"]
    gain = tv.Estimate(np.full(len(model.time), 8.0), "N m s/rad")
    details = model.diagnostics.details | {"reflex_detected": shown}
    reflexive = attrs.evolve(
        model,
        estimates={**model.estimates, "reflex_gain": gain},
        diagnostics=attrs.evolve(model.diagnostics, details=details),
    )
    found = attrs.evolve(identified, models={**identified.models, "adaptive": reflexive})
    assert text in methods_paragraph(found)


@pytest.mark.usefixtures("sketched")
def test_a_stiffness_that_is_not_known_at_any_time_has_a_page_without_a_warning(tmp_path):
    found = tv.compare(ensemble_of(20.0), ["birf"])
    model = found.models["birf"]
    unknown = tv.Estimate(np.full(len(model.time), np.nan), "N m/rad")
    models = {"birf": attrs.evolve(model, estimates={**model.estimates, "stiffness": unknown})}
    found = attrs.evolve(found, models=models)
    assert found.answer.lines == ("birf estimates no stiffness over time",)
    tv.report.write_identification(tmp_path / "report.html", found)
    told = Elements((tmp_path / "report.html").read_text())
    assert "Birf estimates no stiffness over time." in section(told, "outcome")


@pytest.mark.usefixtures("sketched")
def test_a_single_realization_has_a_page_too(tmp_path):
    ensemble = ensemble_of(20.0).select([0])
    found = tv.compare(ensemble, ["kbr"])
    tv.report.write_identification(tmp_path / "report.html", found)
    told = Elements((tmp_path / "report.html").read_text())
    assert "Not diagnosed: expected" in section(told, "diagnosis")
    assert np.isnan(found.answer.vaf["kbr"])
    assert found.time_varying_vaf == {}  # and no axes for it


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::tvsysid.errors.DataQualityWarning")
def test_the_paragraph_says_whose_stiffness_includes_the_reflex():
    simulation = tv.simulate.ReflexJoint(reflex_gain=8.0).simulate(
        40, perturbation=tv.simulate.PRBS(), snr_db=20, seed=1
    )
    ensemble = tv.preprocess.subtract_mean(realizations(simulation.recording))
    diagnosis = tv.diagnose(ensemble)
    told = methods_paragraph(
        attrs.evolve(tv.compare(ensemble, ["cascade", "sds"]), diagnosis=diagnosis)
    )
    assert (
        "This stiffness is the intrinsic one: a stretch reflex was estimated beside it. That of "
        "sds includes" in told
    )
    assert "A diagnosis of the data found: " in told
    told = methods_paragraph(attrs.evolve(tv.compare(ensemble, ["sds"]), diagnosis=diagnosis))
    assert "This stiffness includes a stretch reflex, which the data show." in told
