import shutil
import subprocess
from types import SimpleNamespace

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of
from tests.drawing import sketches
from tests.experimental import claims as experimental_claims
from tests.experimental import fail as fail_recording
from tests.experimental import prepared_of
from tests.experimental import results_of as experimental_results
from tests.experimental import summary_of as experimental_summary
from tests.faults import cut, late, simulated
from tests.synthetic import SQUARE, claims, fail, results_of, summary_of

import tvsysid as tv
from tvsysid.figures import draw_all
from tvsysid.figures.style import panels
from tvsysid.report import write_experiment_report, write_report
from tvsysid.report.experiment import experiment_figures
from tvsysid.report.sheet import facts
from tvsysid.studies.van_de_ruit_2021 import STUDY

HOSTILE = "mine:<script>alert(1)</script>"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def pictures(illustrations):
    """The first is drawn, the others are empty axes: it is the page that is looked at."""
    first, *others = illustrations
    empty = {
        stem: attrs.evolve(illustrations[stem], draw=lambda: panels("", (3.0, 2.0))[0])
        for stem in others
    }
    return draw_all({first: illustrations[first]} | empty)


@pytest.fixture(scope="session")
def study():
    """Results with failures and warnings, and a method whose label is no good."""
    results = results_of(
        [*SQUARE[:2], ("sine", "noise", 150.0, 10.0)],
        ("eirf", "sds:window=0.2", "kbr", HOSTILE),
        trials=3,
    )
    for trial in range(3):
        fail(results, "kbr", trial, "KernelRegression: the record is <too short>")
    results["warnings"][0, :2, 0] = "few realizations"
    return results, summary_of(results)


@pytest.fixture(scope="session")
def page(study, tmp_path_factory):
    """Path of a report."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    figures = pictures(STUDY.figures(*study))
    write_report(path, *study, claims(), figures, "tvsysid benchmark --trials 3 && echo")
    return path


@pytest.fixture(scope="session")
def experiment():
    """Make an experiment with a failed recording, a failed method, warnings, and remarks."""
    results = experimental_results(methods=("eirf", "birf", "kbr", HOSTILE))
    fail_recording(results, "InputError: every file of <P3> is unreadable", recording="P3-prbs")
    fail_recording(
        results, "KernelRegression: no convergence", recording="P1-noise", analysis="kbr-40"
    )
    texts = np.array(["few realizations", "", "", "", "noisy", ""], dtype=object)
    results["warnings"].loc[{"analysis": "birf-75"}] = np.repeat(texts[:, None], 6, axis=1)
    results["remarks"].loc[{"recording": "P2-noise"}] = (
        "trial_3.mat left out: <no torque>\nangle is clipped"
    )
    return SimpleNamespace(results=results, summary=experimental_summary(results))


@pytest.fixture(scope="session")
def experiment_page(experiment, tmp_path_factory):
    """Path of an experiment's report."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    results, summary = experiment.results, experiment.summary
    with sketches():
        figures = pictures(experiment_figures(results, summary, prepared_of(results)))
    command = "tvsysid experiment --virtual 3 && echo"
    write_experiment_report(path, results, summary, experimental_claims(), figures, command)
    return path


@pytest.fixture(scope="session")
def identified():
    """A joint that switches, by three methods; held-out VAF of the quick ones."""
    ensemble = attrs.evolve(
        tv.preprocess.subtract_mean(ensemble_of(120.0, profile="square")), left_out=2
    )
    found = tv.compare(ensemble, ["eirf", "sds", "adaptive"])
    held_out = tv.compare(ensemble, ["eirf", "sds"]).predict_held_out()
    return attrs.evolve(found, held_out=held_out, diagnosis=tv.diagnose(ensemble))


@pytest.fixture(scope="session")
def identification_page(identified, tmp_path_factory):
    """Path of an identification's page."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    command = "tvsysid identify ankle.mat && echo"
    source = {"file": "<ankle>.mat", "angle": "channel pos, in rad", "torque": "channel tq"}
    with sketches():
        tv.report.write_identification(path, identified, command, source=source)
    return path


@pytest.fixture(scope="session")
def diagnoses():
    recording = simulated(60.0)
    return {"clean": tv.diagnose(cut(recording)), HOSTILE: tv.diagnose(cut(late(recording)))}


@pytest.fixture(scope="session")
def diagnosis_page(diagnoses, tmp_path_factory):
    path = tmp_path_factory.mktemp("diagnosis") / "diagnosis.html"
    with sketches():
        tv.report.write_diagnosis(path, diagnoses, "tvsysid inspect ankle.mat --diagnose && echo")
    return path


def write_visit(folder, found):
    """Write what a sheet reads."""
    about = facts(found, "<ankle>.mat")
    tv.recordings.write_models(folder / "models.nc", found.models, about=about)
    tv.recordings.write_table(folder / "stiffness.csv", found.over_time())


@pytest.fixture(scope="session")
def sheet_page(identified, tmp_path_factory):
    """Path of a sheet about as many visits as fit."""
    folder = tmp_path_factory.mktemp("visits")
    folders = [folder / f"visit number {place}" for place in range(1, 7)]
    write_visit(folders[0], identified)
    for each in folders[1:]:
        shutil.copytree(folders[0], each)
    tv.report.write_sheet(folder / "sheet.html", folders)
    return folder / "sheet.html"


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip(f"no browser is installed: {', '.join(BROWSERS)}")
    profile = tmp_path_factory.mktemp("profile")

    def run(*words):
        options = (
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            f"--user-data-dir={profile}",
        )
        command = [found, *options, "--enable-logging=stderr", *map(str, words)]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)

    return run
