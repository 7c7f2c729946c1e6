"""Test methods from outside the package that fail: each is reported, and the others finish."""

import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.report import problems
from tvsysid.study import Study, run

SETTINGS = {"duration_s": 20.0, "trials": 2, "perturbation": "prbs"}


def model_of(ensemble, stiffness=100.0, torque=None):
    """Return a model with nothing wrong but the stiffness or torque given."""
    predicted = 100.0 * ensemble.angle[:, ensemble.core]
    torques = {"intrinsic": predicted} if torque is None else torque(predicted)
    return tv.Model.of(ensemble, stiffness, pathways=lambda _: torques)


class WritesInPlace(tv.Method):
    def fit(self, ensemble):
        ensemble.angle[:] = 0.0


class Refuses(tv.Method):
    def fit(self, ensemble):
        raise tv.InputError("it needs 100 realizations")


class RaisesMegabyte(tv.Method):
    def fit(self, ensemble):
        raise ValueError("\x1b[2J\x00 too much" * 100_000)


class GivesComplex(tv.Method):
    def fit(self, ensemble):
        return model_of(ensemble, np.full(ensemble.samples, 100 + 1j))


class GivesText(tv.Method):
    def fit(self, ensemble):
        return model_of(ensemble, np.full(ensemble.samples, "100"))


class GivesInfinity(tv.Method):
    def fit(self, ensemble):
        return model_of(ensemble, np.r_[np.inf, np.full(ensemble.samples - 1, 100.0)])


class GivesTooMany(tv.Method):
    def fit(self, ensemble):
        return model_of(ensemble, np.ones(1000))


class PredictsTooMuch(tv.Method):
    def fit(self, ensemble):
        return model_of(ensemble, torque=lambda known: {"intrinsic": known[:1]})


class ReturnsNothing(tv.Method):
    def fit(self, ensemble):
        pass


FAILURES = {
    WritesInPlace: "ValueError: assignment destination is read-only (test_own_methods.py, line",
    Refuses: "it needs 100 realizations (test_own_methods.py, line",
    RaisesMegabyte: r"ValueError: \x1b[2J\x00 too much\x1b[2J\x00 too much",
    GivesComplex: "expected real numbers, NaN where not identified, got values of type complex128",
    GivesText: "expected real numbers, NaN where not identified, got values of type <U3",
    GivesInfinity: "some of them infinite",
    GivesTooMany: "stiffness over time must be of shape (200,), it is (1000,)",
    PredictsTooMuch: "must be real numbers of shape (realization, time) = (",
    ReturnsNothing: "fit returned an object of type NoneType; return tvsysid.Model.of(",
}
"""What is said of each."""


@pytest.mark.slow
def test_a_study_reports_each_with_what_it_did():
    results = run(
        Study(**SETTINGS, methods=["sds", *(kind() for kind in FAILURES), "birf"]), workers=1
    )
    told = {
        problem["method"]: problem for problem in problems(results) if problem["kind"] == "failed"
    }
    assert set(told) == {kind.__name__ for kind in FAILURES}
    for kind, reason in FAILURES.items():
        assert reason in told[kind.__name__]["first"]
        assert told[kind.__name__]["count"] == SETTINGS["trials"]
        assert told[kind.__name__]["first"].isprintable()
        assert np.isnan(results.estimate.sel(method_key=kind.__name__)).all()
    alone = run(Study(**SETTINGS, methods=["sds", "birf"]), workers=1)
    np.testing.assert_array_equal(results.estimate.sel(method_key=["sds", "birf"]), alone.estimate)


def test_a_comparison_reports_each_with_what_it_did():
    ensemble = ensemble_of()
    compared = tv.compare(ensemble, ["sds", *(kind() for kind in FAILURES)])
    assert set(compared.failed) == {kind.__name__ for kind in FAILURES}
    for kind, reason in FAILURES.items():
        assert reason in compared.failed[kind.__name__]
    assert list(compared.models) == ["sds"]
    assert "failed: WritesInPlace, Refuses" in repr(compared)
    np.testing.assert_array_equal(
        compared.models["sds"].stiffness, tv.ShortDataSegments().identify(ensemble).stiffness
    )


def test_an_error_beyond_the_ensemble_identified_from_is_the_models_own():
    class PredictsOneEnsemble(tv.Method):
        def fit(self, ensemble):
            return model_of(ensemble)

    ensemble = ensemble_of()
    compared = tv.compare(ensemble, [PredictsOneEnsemble()])
    with pytest.raises(tv.InputError, match="must be real numbers of shape"):
        compared.models["PredictsOneEnsemble"].predict(ensemble.select([0, 1, 2]))
    with pytest.warns(
        tv.DataQualityWarning, match=r"no held-out VAF .* must be real numbers of shape"
    ):
        assert np.isnan(compared.held_out_vaf()["PredictsOneEnsemble"]).all()
