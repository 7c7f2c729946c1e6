"""Test methods from outside the package that fail: each is reported, and the others finish."""

import sys

import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.report import problems
from tvsysid.study import Study, run, summarize

SETTINGS = {"duration_s": 20.0, "trials": 2, "perturbation": "prbs"}


def model_of(ensemble, stiffness=100.0):
    """Return a model with nothing wrong but the stiffness or torque given."""
    predicted = 100.0 * ensemble.angle[:, ensemble.core]
    return tv.Model.of(ensemble, stiffness, pathways=lambda _: {"intrinsic": predicted})


class WritesInPlace(tv.Method):
    def fit(self, ensemble):
        ensemble.angle[:] = 0.0


class Refuses(tv.Method):
    def fit(self, ensemble):
        raise tv.InputError("it needs 100 realizations")


class GivesComplex(tv.Method):
    def fit(self, ensemble):
        return model_of(ensemble, np.full(ensemble.samples, 100 + 1j))


class GivesTooMany(tv.Method):
    def fit(self, ensemble):
        return model_of(ensemble, np.ones(1000))


class ReturnsNothing(tv.Method):
    def fit(self, ensemble):
        pass


class Raises(tv.Method):
    def fit(self, ensemble):
        raise ZeroDivisionError("no such luck")


class Exits(tv.Method):
    def fit(self, ensemble):
        sys.exit(3)


class FindsNothing(tv.Method):
    def fit(self, ensemble):
        return model_of(ensemble, np.full(ensemble.samples, np.nan))


FAILURES = {
    Raises: "ZeroDivisionError: no such luck (test_own_methods.py, line",
    Exits: "SystemExit: 3 (test_own_methods.py, line",
    FindsNothing: "it found no stiffness at any time",
    WritesInPlace: "ValueError: assignment destination is read-only (test_own_methods.py, line",
    Refuses: "it needs 100 realizations (test_own_methods.py, line",
    GivesComplex: "expected real numbers, NaN where not identified, got values of type complex128",
    GivesTooMany: "stiffness over time must be of shape (200,), it is (1000,)",
    ReturnsNothing: "fit returned an object of type NoneType; return tvsysid.Model.of(",
}
"""What is said of each."""


@pytest.mark.slow
def test_a_study_reports_each_with_what_it_did():
    methods = ["sds", *(kind() for kind in FAILURES), "birf"]
    results = run(Study(**SETTINGS, methods=methods), workers=1)
    told = {each["method"]: each for each in problems(results) if each["kind"] == "failed"}
    assert set(told) == {kind.__name__ for kind in FAILURES}
    failed = summarize(results).set_index(["metric", "method"]).value.failed
    for kind, reason in FAILURES.items():
        assert reason in told[kind.__name__]["first"]
        assert told[kind.__name__]["first"].isprintable()
        assert told[kind.__name__]["count"] == failed[kind.__name__] == SETTINGS["trials"]
        assert np.isnan(results.estimate.sel(method_key=kind.__name__)).all()
    alone = run(Study(**SETTINGS, methods=["sds", "birf"]), workers=1)
    np.testing.assert_array_equal(results.estimate.sel(method_key=["sds", "birf"]), alone.estimate)


def test_a_comparison_reports_each_with_what_it_did():
    ensemble = ensemble_of()
    # It lets a program exit, and has no need of a stiffness
    reasons = {kind: FAILURES[kind] for kind in FAILURES if kind not in (Exits, FindsNothing)}
    compared = tv.compare(ensemble, ["sds", *(kind() for kind in reasons)])
    assert set(compared.failed) == {kind.__name__ for kind in reasons}
    for kind, reason in reasons.items():
        assert reason in compared.failed[kind.__name__]
    assert list(compared.models) == ["sds"]
