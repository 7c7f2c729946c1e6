"""Each check finds what it is there for, in a method that is right in all else."""

import sys
import threading
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tvsysid as tv
from tvsysid.check import Check, check_method

BIRF = tv.BasisIRF()


@dataclass(frozen=True)
class Fit:
    """A good method, to be spoiled."""

    def identify(self, ensemble):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tv.DataQualityWarning)
            return BIRF.identify(ensemble)


def spoiled(model, stiffness=None, predict=None):
    return SimpleNamespace(
        stiffness=model.stiffness if stiffness is None else stiffness,
        predict=model.predict if predict is None else predict,
    )


class Writes(Fit):
    def identify(self, ensemble):
        angle = ensemble.angle
        angle -= angle.mean()
        return super().identify(ensemble)


class Replaces(Fit):
    def identify(self, ensemble):
        object.__setattr__(ensemble, "torque", 1.001 * ensemble.torque)
        return super().identify(ensemble)


class Crashes(Fit):
    def identify(self, ensemble):
        return np.zeros(3) @ np.zeros(4)


class CrashesFarBelow(Fit):
    def identify(self, ensemble):
        return np.linalg.inv(np.zeros((2, 2)))


class ReturnsNothing(Fit):
    def identify(self, ensemble):
        super().identify(ensemble)


class ReturnsArray(Fit):
    def identify(self, ensemble):
        return super().identify(ensemble).stiffness


class CountsContext(Fit):
    def identify(self, ensemble):
        return spoiled(super().identify(ensemble), stiffness=np.ones(ensemble.angle.shape[1]))


class Complex(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        return spoiled(model, predict=lambda other: model.predict(other) + 0j)


class Integers(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        return spoiled(model, stiffness=np.nan_to_num(model.stiffness).astype(int))


class Infinite(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        return spoiled(model, stiffness=np.full(ensemble.samples, np.inf))


class KnowsNothing(Fit):
    def identify(self, ensemble):
        return spoiled(super().identify(ensemble), stiffness=np.full(ensemble.samples, np.nan))


class Reversed(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        return spoiled(model, stiffness=-model.stiffness)


class Degrees(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        return spoiled(model, stiffness=np.radians(model.stiffness))


class PredictsElastically(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        return spoiled(
            model, predict=lambda other: model.stiffness * other.angle[:, other.core] / 2
        )


class RemembersItsPrediction(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        torque = model.predict(ensemble)
        return spoiled(model, predict=lambda other: torque)


class TakesAsConstant(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        return spoiled(model, stiffness=np.full(ensemble.samples, np.nanmean(model.stiffness)))


class Random(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        return spoiled(
            model,
            stiffness=model.stiffness
            + 0.01 * np.random.default_rng().normal(size=ensemble.samples),
        )


class ReturnsItself:
    def identify(self, ensemble):
        self.model = Fit().identify(ensemble)
        self.stiffness = self.model.stiffness
        return self

    def predict(self, ensemble):
        return self.model.predict(ensemble)


@dataclass(frozen=True)
class HoldsLock(Fit):
    lock: Any = field(default_factory=threading.Lock)


class Threshold(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        return spoiled(model, stiffness=np.minimum(model.stiffness, 200.0))


class HundredHertz(Fit):
    def identify(self, ensemble):
        return super().identify(
            tv.Ensemble(ensemble.angle, ensemble.torque, 100.0, ensemble.context)
        )


class TwoSeconds(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        return spoiled(model, stiffness=np.resize(model.stiffness, 200))


class InventsEdges(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        if ensemble.context:
            return model
        stiffness = model.stiffness.copy()
        stiffness[:5] = 0.0
        return spoiled(model, stiffness=stiffness)


class InventsTorque(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        return spoiled(model, predict=lambda other: np.nan_to_num(model.predict(other)))


class NeedsMany(Fit):
    def identify(self, ensemble):
        if len(ensemble) < 5:
            raise tv.InputError("give at least 5 realizations")
        return super().identify(ensemble)


class CrashesOnFew(Fit):
    def identify(self, ensemble):
        if len(ensemble) < 5:
            raise IndexError("out of range")
        return super().identify(ensemble)


class SingularOnFew(Fit):
    def identify(self, ensemble):
        if len(ensemble) < 5:
            np.linalg.inv(np.zeros((2, 2)))
        return super().identify(ensemble)


class Chatters(Fit):
    def identify(self, ensemble):
        warnings.warn("all is well", UserWarning, stacklevel=1)
        return super().identify(ensemble)


class Doubts(Fit):
    def identify(self, ensemble):
        warnings.warn("all is not well", tv.DataQualityWarning, stacklevel=1)
        return super().identify(ensemble)


class WrongInputs(Fit):
    inputs = ("emg",)


class TooManyInputs(Fit):
    inputs = (
        tv.methods.Input("emg", "scheduling", "1"),
        tv.methods.Input("force", "reference", "N"),
    )


class Skips(Fit):
    def skip(self, ensemble):
        return "it is closed today"


class NeedsManyOrSkips(Fit):
    def skip(self, ensemble):
        return None if len(ensemble) > 5 else "it needs 6 realizations"


class OverAnotherAxis(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        values = tv.Estimate(np.ones(4), "N m/rad", ("emg",))
        return SimpleNamespace(
            estimates={"stiffness": values},
            coordinates={"emg": np.arange(4.0)},
            predict=model.predict,
        )


class WithoutCoordinates(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        more = tv.Estimate(np.ones(4), "N m/rad", ("emg",))
        return SimpleNamespace(estimates={**model.estimates, "more": more}, predict=model.predict)


class SaysTooMuch(Fit):
    quantities = ("reflex_gain",)


class SaysScheduled(Fit):
    scheduled_quantities = ("stiffness_at_emg",)


class SaysOtherScheduled(Fit):
    scheduled_quantities = {"stiffness_at_emg": 3}  # noqa: RUF012


class TooManyScheduled(Fit):
    scheduled_quantities = {"stiffness": 3}  # noqa: RUF012


class SaysOtherPathways(Fit):
    pathway_names = ("intrinsic", "reflexx")


class WrongLength(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)
        return SimpleNamespace(
            estimates={**model.estimates, "reflex_gain": np.ones(7)}, predict=model.predict
        )


class SecondPathway(Fit):
    def identify(self, ensemble):
        model = super().identify(ensemble)

        def pathways(other):
            return {"intrinsic": model.predict(other), "reflex": 0.1 * other.torque[:, other.core]}

        return SimpleNamespace(stiffness=model.stiffness, predict=model.predict, pathways=pathways)


class NoReflex(SecondPathway):
    def identify(self, ensemble):
        model = Fit().identify(ensemble)

        def pathways(other):
            return {
                "intrinsic": model.predict(other),
                "reflex": np.zeros((len(other), other.samples)),
            }

        return SimpleNamespace(stiffness=model.stiffness, pathways=pathways)


def failed(method):
    return [check for check in check_method(method) if not check.passed and check.run]


@pytest.mark.parametrize(
    "method",
    [
        Fit(),
        NeedsMany(),
        NeedsManyOrSkips(),
        Doubts(),
        *map(tv.methods.create, tv.methods.PAPER_METHODS),
    ],
    ids=repr,
)
def test_good_methods_pass(method):
    assert failed(method) == []


@pytest.mark.parametrize(
    ("method", "name", "words"),
    [
        (Fit, "has identify", "got the class Fit itself; give Fit()"),
        (
            3,
            "has identify",
            "expected an object with identify(ensemble), got an object of type int",
        ),
        (Writes(), "identifies a joint", "work on a copy, as in ensemble.angle.copy()"),
        (
            Replaces(),
            "leaves the ensemble untouched",
            "identify changed the ensemble, which all methods share",
        ),
        (
            WrongInputs(),
            "states its inputs",
            "inputs must be a tuple of tvsysid.methods.Input (with a comma",
        ),
        (
            TooManyInputs(),
            "states its inputs",
            "no system that the package simulates has all of emg, force",
        ),
        (
            Skips(),
            "states its inputs",
            "torque RMS 0.963 N·m): it is closed today",
        ),
        (
            OverAnotherAxis(),
            "returns a model",
            "expected an estimate of stiffness over time, got stiffness",
        ),
        (
            WithoutCoordinates(),
            "returns a model",
            "more has the axis 'emg', for which the model has no coordinates",
        ),
        (
            SaysTooMuch(),
            "returns a model",
            "expected estimates of all its quantities, got none of reflex_gain",
        ),
        (SaysScheduled(), "returns a model", "as in {'stiffness_at_emg': 20}, got ('stiff"),
        (
            SaysOtherScheduled(),
            "returns a model",
            "of all its quantities, got none of stiffness_at_emg",
        ),
        (TooManyScheduled(), "returns a model", "expected 3 values of stiffness at most"),
        (
            SaysOtherPathways(),
            "has pathways that add up",
            "of its pathway_names, got none of reflexx",
        ),
        (
            WrongLength(),
            "returns a model",
            "reflex_gain over time must be of shape (200,), it is (7,)",
        ),
        (
            SecondPathway(),
            "has pathways that add up",
            "expected pathways(ensemble) with predict(ensemble) as",
        ),
        (Crashes(), "identifies a joint", "it stopped with ValueError: matmul"),
        (
            CrashesFarBelow(),
            "identifies a joint",
            "LinAlgError: Singular matrix (test_check.py, line ",
        ),
        (ReturnsNothing(), "returns a model", "identify returned None"),
        (
            ReturnsArray(),
            "returns a model",
            "an object of type ndarray without stiffness and predict(ensemble)",
        ),
        (CountsContext(), "returns a model", "= (200,), got (300,); this counts the context"),
        (
            Complex(),
            "returns a model",
            "expected predict(ensemble) as real floating-point numbers, got complex128",
        ),
        (
            Integers(),
            "returns a model",
            "expected stiffness as real floating-point numbers, got int64",
        ),
        (Infinite(), "returns a model", "stiffness holds infinite values; give NaN"),
        (KnowsNothing(), "returns a model", "stiffness is NaN at 100 % of the samples"),
        (Reversed(), "recovers a constant stiffness", "the sign is reversed"),
        (Degrees(), "recovers a constant stiffness", "1.75 N·m/rad in the mean, where 100 is true"),
        (PredictsElastically(), "predicts the torque", "expected more than 80 %"),
        (
            RemembersItsPrediction(),
            "predicts the torque",
            "of shape (realization, time) = (20, 200), got (75, 200)",
        ),
        (Random(), "gives the same numbers again", "give random numbers a fixed seed"),
        (
            ReturnsItself(),
            "gives the same numbers again",
            "the first model changed when identify was called again",
        ),
        (HoldsLock(), "can be sent to a worker", "hold no open file, lock or generator in it"),
        (
            Threshold(),
            "scales with the torque",
            "ten times the torque gave 2 times the stiffness; expected 10",
        ),
        (
            HundredHertz(),
            "works at another rate and length",
            "192 samples at 100 Hz, the ensemble 192 at 128 Hz",
        ),
        (TwoSeconds(), "works at another rate and length", "= (192,), got (200,)"),
        (InventsEdges(), "works without context", "stiffness is up to"),
        (InventsTorque(), "works without context", "predict(ensemble) has a VAF of"),
        (
            CrashesOnFew(),
            "takes few realizations, or says that it does not",
            "3 realizations: IndexError: out of",
        ),
        (
            SingularOnFew(),
            "takes few realizations, or says that it does not",
            "3 realizations: LinAlgError: Singular",
        ),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Fit) else None,
)
def test_fault_is_found_and_told(method, name, words):
    first = failed(method)[0]
    assert first.name == name
    assert words in first.message
    assert first.required
    assert "\n" not in first.message
    assert "Traceback" not in first.message


@pytest.mark.parametrize(
    ("method", "name", "words"),
    [
        (
            TakesAsConstant(),
            "follows a changing stiffness",
            "takes stiffness as constant can be compared",
        ),
        (Chatters(), "uses the package's warning class", "UserWarning: all is well"),
        (
            NoReflex(),
            "separates intrinsic and reflex torque",
            "% of the reflex torque; expected more than 50 %",
        ),
    ],
    ids=["constant", "chatters", "no reflex"],
)
def test_advice_is_no_requirement(method, name, words):
    (check,) = failed(method)
    assert check.name == name
    assert words in check.message
    assert not check.required


def test_line_of_the_users_file_is_named():
    line = 1 + Path(__file__).read_text().splitlines().index("        angle -= angle.mean()")
    assert f"(test_check.py, line {line})" in failed(Writes())[0].message


def test_what_depends_on_a_failure_is_not_run():
    checks = {check.name: check for check in check_method(ReturnsNothing())}
    assert checks["identifies a joint"].passed
    for name in (
        "recovers a constant stiffness",
        "can be sent to a worker",
        "works without context",
    ):
        assert checks[name].message == "not run: 'returns a model' failed"
        assert not checks[name].passed
    checks = {check.name: check for check in check_method(Crashes())}
    assert checks["leaves the ensemble untouched"].message == "not run: 'identifies a joint' failed"


def test_every_check_is_there_whatever_the_method():
    names = [check.name for check in check_method(Fit())]
    assert len(set(names)) == len(names)
    for method in (None, Crashes(), Random()):
        assert [check.name for check in check_method(method)] == names


def test_a_method_that_leaves_the_program_stops_nothing():
    class Leaves(Fit):
        def identify(self, ensemble):
            sys.exit("good bye")

    assert "SystemExit: good bye" in failed(Leaves())[0].message


def test_check_is_immutable():
    with pytest.raises(AttributeError):
        Check("name", True, "message").passed = False
