"""Methods from outside the package that fail: each is reported with what it did, and the others finish."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.report import problems
from tvsysid.study import Study, run

SETTINGS = {"duration_s": 20.0, "trials": 2, "perturbation": "prbs"}


def found(ensemble, stiffness=None, torque=None):
    """A model with nothing wrong but the stiffness or torque given."""
    values = np.full(ensemble.samples, 100.0) if stiffness is None else stiffness
    predicted = 100.0 * ensemble.angle[:, ensemble.core]
    return SimpleNamespace(
        stiffness=values, predict=lambda _: predicted if torque is None else torque(predicted)
    )


class WritesInPlace:
    def identify(self, ensemble):
        ensemble.angle[:] = 0.0


class Exits:
    def identify(self, ensemble):
        sys.exit(0)


class Refuses:
    def identify(self, ensemble):
        raise tv.InputError("it needs 100 realizations")


class UnreadableError(Exception):
    def __str__(self):
        raise KeyboardInterrupt


class RaisesUnreadable:
    def identify(self, ensemble):
        raise UnreadableError


class RaisesMegabyte:
    def identify(self, ensemble):
        raise ValueError("\x1b[2J\x00 too much" * 100_000)


class GivesComplex:
    def identify(self, ensemble):
        return found(ensemble, np.full(ensemble.samples, 100 + 1j))


class GivesText:
    def identify(self, ensemble):
        return found(ensemble, np.full(ensemble.samples, "100"))


class GivesInfinity:
    def identify(self, ensemble):
        return found(ensemble, np.r_[np.inf, np.full(ensemble.samples - 1, 100.0)])


class GivesMasked:
    def identify(self, ensemble):
        return found(ensemble, np.ma.masked_less(np.arange(float(ensemble.samples)), 50))


class GivesTooMany:
    def identify(self, ensemble):
        return found(ensemble, np.broadcast_to(100.0, 10**12))


class PredictsInfinity:
    def identify(self, ensemble):
        return found(ensemble, torque=lambda known: known + np.inf)


class HasNoPathways:
    def identify(self, ensemble):
        return SimpleNamespace(stiffness=np.full(ensemble.samples, 100.0), pathways=lambda _: {})


FAILURES = {
    WritesInPlace: "ValueError: assignment destination is read-only (test_own_methods.py, line",
    Exits: "SystemExit: 0 (test_own_methods.py, line",
    Refuses: "it needs 100 realizations (test_own_methods.py, line",
    RaisesUnreadable: "UnreadableError: its text cannot be read",
    RaisesMegabyte: r"ValueError: \x1b[2J\x00 too much\x1b[2J\x00 too much",
    GivesComplex: "expected real numbers, got values of type complex128",
    GivesText: "expected real numbers, got values of type <U3",
    GivesInfinity: "some of them infinite; give NaN where nothing can be said",
    GivesMasked: "got a masked array; fill what is masked with NaN",
    GivesTooMany: "the model's stiffness must be of shape (200,), it is (1000000000000,)",
    PredictsInfinity: "some of them infinite; give NaN where nothing can be said",
    HasNoPathways: "must be a mapping of the torque of each pathway by its name, got none",
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
    assert "failed: WritesInPlace, Exits, Refuses" in repr(compared)
    np.testing.assert_array_equal(
        compared.models["sds"].stiffness, tv.ShortDataSegments().identify(ensemble).stiffness
    )


def test_an_error_beyond_the_ensemble_identified_from_is_the_models_own():
    class PredictsOneEnsemble:
        def identify(self, ensemble):
            return found(ensemble)

    ensemble = ensemble_of()
    compared = tv.compare(ensemble, [PredictsOneEnsemble()])
    with pytest.raises(tv.InputError, match="must be of shape"):
        compared.models["PredictsOneEnsemble"].predict(ensemble.select([0, 1, 2]))
    with pytest.warns(tv.DataQualityWarning, match=r"no held-out VAF .* must be of shape"):
        assert np.isnan(compared.held_out_vaf()["PredictsOneEnsemble"]).all()
