"""Each check finds the fault that it is there for, in a method without any other."""

import threading
from collections.abc import Callable
from typing import Any

import attrs
import numpy as np
import pytest

import tvsysid as tv
from tvsysid.check import check_method

BIRF = tv.BasisIRF()


def unchanged(model, ensemble):
    return model


@attrs.define
class Fit(tv.Method):
    """A good method, whose model is changed."""

    change: Callable = unchanged
    held: Any = None

    def fit(self, ensemble):
        return self.change(BIRF.fit(ensemble), ensemble)


def spoiled(stiffness=None, torque=None):
    """Return a method that changes its stiffness or torque by these functions."""

    def change(model, ensemble):
        values = model.stiffness if stiffness is None else stiffness(model.stiffness)

        def pathways(other):
            return {"intrinsic": torque(model, other) if torque else model.predict(other)}

        return tv.Model.of(ensemble, values, pathways=pathways)

    return Fit(change)


def writes(model, ensemble):
    angle = ensemble.angle
    angle -= angle.mean()


def remembers(model, ensemble):
    torque = model.predict(ensemble)
    return tv.Model.of(ensemble, model.stiffness, pathways=lambda other: {"intrinsic": torque})


def at_one_rate(model, ensemble):
    return BIRF.fit(tv.Ensemble(ensemble.angle, ensemble.torque, 100.0, ensemble.context))


def declares(**attributes):
    return type("Declares", (Fit,), attributes)()


@pytest.mark.parametrize(
    "method",
    [
        Fit(),
        declares(skip=lambda self, ensemble: None if len(ensemble) > 5 else "it needs 6"),
    ],
)
def test_good_methods_pass(method):
    assert [check for check in check_method(method) if not check.passed] == []


@pytest.mark.parametrize(
    ("method", "name", "words"),
    [
        (Fit(writes), "identifies a joint", "read-only (test_check.py, line "),
        (Fit(lambda *_: None), "identifies a joint", "fit returned an object of type NoneType"),
        (spoiled(lambda known: np.ones(300)), "identifies a joint", "must be of shape (200,)"),
        (
            declares(inputs=(tv.Input("a", "input", "1"), tv.Input("b", "reference", "1"))),
            "identifies a joint",
            "it needs the channel 'b'",
        ),
        (
            Fit(lambda model, ensemble: tv.Model.of(ensemble, inertia=1.0)),
            "identifies a joint",
            "100 % of the values are NaN",
        ),
        (spoiled(np.radians), "recovers a constant stiffness", "mean 1.75 N·m/rad"),
        (
            spoiled(torque=lambda model, other: 50 * other.angle[:, other.core]),
            "predicts the torque",
            "expected more than 80 %",
        ),
        (Fit(remembers), "predicts the torque", "of shape (realization, time) = (20, 200)"),
        (
            spoiled(lambda known: np.full(len(known), np.nanmean(known))),
            "follows a changing stiffness",
            "time_invariant = True",
        ),
        (
            spoiled(lambda known: known + 0.01 * np.random.default_rng().normal(size=len(known))),
            "gives the same numbers again",
            "give random numbers a fixed seed",
        ),
        (
            Fit(held=threading.Lock()),
            "gives the same numbers again",
            "cannot pickle '_thread.lock' object",
        ),
        (Fit(at_one_rate), "works at another rate and length", "192 samples at 100 Hz"),
    ],
)
def test_a_fault_is_found(method, name, words):
    first = next(check for check in check_method(method) if not check.passed)
    assert first.name == name
    assert words in first.message
    assert "\n" not in first.message
