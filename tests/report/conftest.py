import pytest
from tests.synthetic import SQUARE, claims, fail, responses_of, results_of, summary_of

from tvsysid.figures import study_figures
from tvsysid.report import write_report

HOSTILE = "mine:<script>alert(1)</script>"


@pytest.fixture(scope="session")
def study():
    """Results with failures and doubts, and a method whose label is no good."""
    results = results_of(
        [*SQUARE[:2], ("sine", "noise", 150.0, 10.0)], ("eirf", "sds:window=0.2", "kbr", HOSTILE), trials=3
    )
    for trial in range(3):
        fail(results, "kbr", trial, "KernelRegression: the record is <too short>")
    results["doubts"][0, :2, 0] = "few realizations"
    return results, summary_of(results)


@pytest.fixture(scope="session")
def page(study, tmp_path_factory):
    """Path of a report."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    figures = study_figures(*study, responses_of())
    write_report(path, *study, claims(), figures, "tvsysid benchmark --trials 3 && echo")
    return path
