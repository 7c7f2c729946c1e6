"""The examples of pages run, and what the pages name is there."""

import importlib
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from tests.docs.pages import DOCS, run, text_of
from tests.faults import simulated

import tvsysid as tv
from tvsysid.quality import FAULTS

REFLEX, NLID = text_of("reflex.md"), text_of("nlid.md")
loud = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


@pytest.mark.parametrize("page", ["formats.md", "cluster.md", "planning.md"])
def test_the_example_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(page)


@loud
def test_the_example_mends_what_the_loop_biases(capsys):
    run("closed-loop.md")
    opened, closed, predicted = map(float, capsys.readouterr().out.split())
    assert opened < 85
    assert abs(closed - 100) < 8
    assert predicted > 80


def test_the_methods_of_the_table_take_a_reference():
    found = r"^\| `(\w+:[\w=,]*reference=NAME[\w=,]*)`"
    words = re.findall(found, text_of("closed-loop.md"), re.MULTILINE)
    assert {word.partition(":")[0] for word in words} == {"kbr", "birf", "esm", "sds"}
    assert all(tv.methods.parse(word).inputs[0].kind == "reference" for word in words)


def test_the_site_lists_every_check_with_its_limit_effect_and_remedy(monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "extensions")
    told = importlib.import_module("reference").checks()
    for name, fault in FAULTS.items():
        assert f"### `{name}`: {fault.title}" in told
        assert f"wrong {fault.wrong} {fault.limit:g} {fault.unit}" in told
        assert f"- Effect: {fault.effect}.\n- Remedy: {fault.remedy}." in told


@pytest.mark.usefixtures("sketched")
def test_the_example_diagnoses_a_reversed_torque(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    recording = simulated(60.0, "noise", "square", 20.0, 0)
    savemat("ankle.mat", {"angle": recording.angle, "torque": -recording.torque})
    run("diagnosis.md")
    assert "reversed" in capsys.readouterr().out
    assert (tmp_path / "page.html").exists()


@loud
def test_the_example_for_those_who_know_nlid_runs(capsys):
    names = run("nlid.md")
    explained, area = capsys.readouterr().out.split()
    assert float(explained) > 70
    assert area == "True"
    assert set(names["pathways"]) == {"intrinsic", "reflex"}
    assert abs(names["sdss"].stiffness.mean() - 100) < 6


def test_names_beside_those_of_nlid_exist():
    for name in set(re.findall(r"\btv((?:\.\w+)+)", NLID)):
        found = tv
        for part in name.strip(".").split("."):
            found = getattr(found, part)


@pytest.mark.slow
def test_the_example_separates_what_other_methods_take_for_stiffness(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = run("reflex.md")
    truth = names["simulation"].truth_of(names["prepared"].ensemble)
    models = names["found"].models
    for name, error in (("stiffness", 1.0), ("reflex_gain", 0.4)):
        off = models["cascade"].estimates[name].values - truth[name]
        assert np.sqrt(np.mean(off**2)) < error
    for key in ("kbr", "sds"):
        assert models[key].stiffness.mean() > truth["stiffness"].mean() + 10
    assert Path("reflex.png").stat().st_size > 10_000


def test_the_table_names_all_methods_of_two_pathways():
    table = REFLEX.split("## Which method when")[1].split("##")[0]
    named = set(re.findall(r"`(\w+)(?::\w+=\w+)?`", table)) - {"emg"}
    assert named == {
        key for key in tv.methods.METHODS if tv.methods.describe(key).purpose == "two pathways"
    }


def test_the_example_finds_the_relation():
    names = run("scheduling.md")
    truth = names["joint"].relation(np.array([-0.3, 0.0, 0.2]))
    assert np.abs(names["found"]["stiffness"].values - truth).max() < 2
    assert names["model"].diagnostics.details["vaf_folds"] > 95


def test_methods_and_settings_for_a_scheduling_variable_are_there():
    for text in set(re.findall(r"`(lpv[\w:=,]*)`", text_of("scheduling.md"))):
        tv.methods.parse(text)


def test_the_examples_of_special_perturbations_run(capsys):
    assert run("special-perturbations.md")["error"] < 4.0
    assert "no impulses" in capsys.readouterr().out
