"""A method that is checked, and the simulated joints that it is given."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any, NamedTuple

import attrs
import numpy as np

from tvsysid import simulate
from tvsysid.errors import DataQualityWarning, describe_error
from tvsysid.estimates import plain_array
from tvsysid.methods import found_as
from tvsysid.methods.apply import apply
from tvsysid.methods.base import Input, inputs_of, special
from tvsysid.preprocess import decimate, segment
from tvsysid.signals import Array, Ensemble, Recording

LEVEL = 100.0  # stiffness of the constant joint in N·m/rad
SNR = 30.0  # signal-to-noise ratio of the simulated torque in dB
# Duration in s, stiffness, rate in Hz, period in s, seed.
CASES: dict[str, tuple[float, simulate.Profile, float, float, int]] = {
    "constant": (150.0, simulate.Constant(LEVEL), 100.0, 2.0, 1),
    "changing": (150.0, simulate.SineWave(), 100.0, 2.0, 2),
    "unseen": (40.0, simulate.Constant(LEVEL), 100.0, 2.0, 3),
    "other rate": (120.0, simulate.SineWave(period=1.5), 128.0, 1.5, 4),
    "reflex": (150.0, simulate.Constant(LEVEL), 100.0, 2.0, 5),
}


class FailedError(Exception):
    """A check failed; the message says how."""


class Case(NamedTuple):
    """A simulated joint and the truth about it, (realization, time).

    The noiseless torque is the pathways' sum.
    """

    ensemble: Ensemble
    torque: Array
    stiffness: Array
    pathways: dict[str, Array]


@cache
def simulated_case(
    name: str, inputs: tuple[Input, ...], perturbation: str = "", joint: str = ""
) -> Case:
    """Case of this name on a system with the channels of these inputs.

    The same one for every method.

    The perturbation and the system are those of these names and settings, filtered noise and
    what fits without any.
    """
    if name == "without context":
        whole = simulated_case("other rate", inputs, perturbation, joint)
        seen = whole.ensemble
        cores = {
            each: seen.signal(each)[:, seen.core] for each in ("angle", "torque", *seen.channels)
        }
        recorded = None if seen.recorded_angle is None else seen.recorded_angle[:, seen.core]
        angle, torque = cores.pop("angle"), cores.pop("torque")
        bare = Ensemble(angle, torque, seen.sampling_rate, channels=cores, recorded_angle=recorded)
        return whole._replace(ensemble=bare)
    duration, profile, rate, period, seed = CASES[name]
    system = (
        simulate.ReflexJoint(stiffness=profile) if name == "reflex" else _system(profile, inputs)
    )
    if joint:
        system = attrs.evolve(found_as(joint, simulate.SYSTEMS, "system"), stiffness=profile)
    kind = found_as(perturbation or "noise", simulate.PERTURBATIONS, "perturbation")
    simulation = system.simulate(duration, perturbation=kind, snr_db=SNR, seed=seed, rate=8 * rate)
    recording = attrs.evolve(simulation.recording, channels=_channels(simulation.recording, inputs))

    def segmented(torque: Array) -> Ensemble:
        return segment(decimate(attrs.evolve(recording, torque=torque), rate), period)

    ensemble = segmented(recording.torque)
    pathways = {
        each: segmented(torque).torque[:, ensemble.core]
        for each, torque in simulation.pathways.items()
    }
    stiffness = simulation.truth_of(ensemble)["stiffness"]
    return Case(ensemble, np.asarray(sum(pathways.values())), stiffness, pathways)


def _system(profile: simulate.Profile, inputs: tuple[Input, ...]) -> simulate.System:
    """What has channels of these kinds."""
    kinds = {item.kind for item in inputs}
    if "reference" in kinds:
        return simulate.CompliantActuator(stiffness=profile)
    return (
        simulate.ScheduledJoint(stiffness=profile) if kinds else simulate.Joint(stiffness=profile)
    )


def _channels(recording: Recording, inputs: tuple[Input, ...]) -> dict[str, Array]:
    """Channels of a simulated recording under the names that the inputs have."""
    if len(inputs) > len(recording.channels):
        raise FailedError(
            "no system that the package simulates has all of "
            f"{', '.join(item.name for item in inputs)}; expected one "
            "reference, or one scheduling variable or input"
        )
    return dict(zip((item.name for item in inputs), recording.channels.values(), strict=False))


@attrs.frozen
class _Found:
    """A method that has identified already."""

    model: object

    def identify(self, ensemble: Ensemble) -> object:
        """Return the model."""
        return self.model


class Subject:
    """A method, and what it has identified so far."""

    def __init__(self, method: Any) -> None:
        self.method = method
        self.models: dict[str, Any] = {}
        self.first = np.empty(0)
        self.warned: dict[str, None] = {}

    def described(self, error: BaseException) -> str:
        """Error in a line, with the place in the file in which identify is written."""
        code = getattr(getattr(self.method, "identify", None), "__code__", None)
        return describe_error(error, None if code is None else str(code.co_filename))

    def case(self, name: str) -> Case:
        """Case of this name, with the channels that the method needs."""
        return simulated_case(name, *self.needs)

    @property
    def needs(self) -> tuple[tuple[Input, ...], str, str]:
        """Inputs of the method, and the perturbation and the system that it serves, if they are special."""
        return (
            inputs_of(self.method),
            special(self.method, "perturbation"),
            special(self.method, "system"),
        )

    def identify(self, ensemble: Ensemble) -> Any:
        """Whatever it returns."""
        with self._listening():
            return self.method.identify(ensemble)

    def model(self, name: str) -> Any:
        """What it returned for the case of this name; identified once."""
        if name not in self.models:
            self.models[name] = self.identify(self.case(name).ensemble)
        return self.models[name]

    def stiffness(self, model: Any, ensemble: Ensemble) -> Array:
        """Stiffness of a model, if it is one, shape (realization, time).

        The same for all where it tells none apart.
        """
        if not isinstance(getattr(model, "estimates", None), Mapping):
            numbers("stiffness", model.stiffness, ensemble, over="(time,)")
        estimates = apply(_Found(model), ensemble, type(self.method).__name__).estimates
        if "stiffness" not in estimates or estimates["stiffness"].axes[-1] != "time":
            raise FailedError(
                f"expected an estimate of stiffness over time, got {', '.join(estimates) or 'none'}"
            )
        return np.broadcast_to(estimates["stiffness"].values, (len(ensemble), ensemble.samples))

    def predict(self, model: Any, ensemble: Ensemble) -> Array:
        """Torque that a model predicts, if it is one, shape (realization, time)."""
        with self._listening():
            own = (
                model.predict(ensemble)
                if hasattr(model, "predict")
                else sum(model.pathways(ensemble).values())
            )
        return numbers("predict(ensemble)", own, ensemble)

    def result(self, name: str) -> tuple[Case, Array, Array]:
        """Case of this name, and the stiffness and torque that the model of it has at most samples."""
        case, model = self.case(name), self.model(name)
        stiffness, torque = self.stiffness(model, case.ensemble), self.predict(model, case.ensemble)
        for what, values in (("stiffness", stiffness), ("predict(ensemble)", torque)):
            missing = 100 * float(np.mean(np.isnan(values)))
            if missing > 50:
                raise FailedError(
                    f"{what} is NaN at {missing:.0f} % of the samples; expected numbers at most "
                    "of them"
                )
        return case, stiffness, torque

    @contextmanager
    def _listening(self) -> Iterator[None]:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield
        for item in caught:
            if not issubclass(item.category, DataQualityWarning):
                self.warned[f"{item.category.__name__}: {item.message}"] = None


def numbers(
    what: str, given: object, ensemble: Ensemble, over: str = "(realization, time)"
) -> Array:
    """Real numbers of the shape that they should have; NaN among them, but nothing infinite."""
    values = plain_array(what, given)
    shape = (len(ensemble), ensemble.samples)[over == "(time,)" :]
    if values.shape != shape:
        with_context = ensemble.context > 0 and values.shape[-1:] == ensemble.angle.shape[1:]
        advice = (
            "; this counts the context on both sides too: take only the samples of ensemble.core"
            * with_context
        )
        raise FailedError(f"expected {what} of shape {over} = {shape}, got {values.shape}{advice}")
    if values.dtype.kind != "f":
        advice = "np.asarray(values, dtype=float) converts what is real"
        raise FailedError(
            f"expected {what} as real floating-point numbers, got {values.dtype}; {advice}"
        )
    if np.isinf(values).any():
        raise FailedError(f"{what} holds infinite values; give NaN where nothing can be said")
    return np.asarray(values, dtype=np.float64)
