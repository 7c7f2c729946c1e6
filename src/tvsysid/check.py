"""Check a method of your own: what every method must do, tried on simulated joints."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import attrs
import cloudpickle
import numpy as np

from tvsysid import metrics, simulate
from tvsysid.errors import DataQualityWarning, InputError, describe_error
from tvsysid.methods import Input, Method, resolve
from tvsysid.models import IMPEDANCE, Model
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.threads import single_thread
from tvsysid.preprocess import decimate, segment
from tvsysid.signals import Array, Ensemble

STIFFNESS = 100.0  # N·m/rad, of the constant joint
SNR_DB = 30.0
MIN_VAF = 80.0  # % of the noiseless torque
EDGE_S = 0.1
# Duration in s, stiffness, rate in Hz, period in s, seed.
CASES: dict[str, tuple[float, simulate.Profile, float, float, int]] = {
    "constant": (150.0, simulate.Constant(STIFFNESS), 100.0, 2.0, 1),
    "changing": (150.0, simulate.SineWave(), 100.0, 2.0, 2),
    "unseen": (40.0, simulate.Constant(STIFFNESS), 100.0, 2.0, 3),
    "other rate": (120.0, simulate.SineWave(period=1.5), 128.0, 1.5, 4),
    "reflex": (150.0, simulate.Constant(STIFFNESS), 100.0, 2.0, 5),
}


@attrs.frozen
class Check:
    """Result of one check.

    Parameters
    ----------
    name
        What is checked.
    passed
        Whether the method does it.
    message
        What happened and, if the check failed, what to do.
    required
        Whether a method must pass; otherwise the check is a recommendation.
    run
        Whether it was run; none is where the method cannot identify a joint at all.
    """

    name: str
    passed: bool
    message: str
    required: bool = True
    run: bool = True


class FailedError(Exception):
    """A check failed; the message says how."""


class Case(NamedTuple):
    """Ensemble of a simulated joint, and its true stiffness and torques (realization, time)."""

    ensemble: Ensemble
    stiffness: Array
    pathways: dict[str, Array]

    @property
    def torque(self) -> Array:
        """Torque without noise."""
        return np.asarray(sum(self.pathways.values()))


def check_method(method: Method) -> list[Check]:
    """Check a method on simulated joints of known stiffness, which have the channels of its inputs.

    Nothing is raised, whatever the method does. All checks come in their order.

    Examples
    --------
    >>> from tvsysid.methods import parse
    >>> all(check.passed for check in check_method(parse("sds")))
    True
    """
    results: list[Check] = []
    trials = Trials(method)
    with single_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        for name, (check, required) in CHECKS.items():
            if results and not results[0].passed:
                message = f"not run: {results[0].name!r} failed"
                results.append(Check(name, False, message, required, run=False))
                continue
            try:
                results.append(Check(name, True, check(trials), required))
            except FailedError as error:
                results.append(Check(name, False, str(error), required))
            except (Exception, SystemExit) as error:
                advice = "; work on a copy of it" if "read-only" in str(error) else ""
                results.append(Check(name, False, f"{describe_error(error)}{advice}", required))
    return results


class Trials:
    """A method and its models of simulated joints; each is identified once."""

    def __init__(self, method: Method) -> None:
        self.method = method
        self.models: dict[str, Model] = {}

    def case(self, name: str) -> Case:
        """Return a simulated joint."""
        return simulated_case(
            name, tuple(self.method.inputs), self.method.perturbation, self.method.system
        )

    def model(self, name: str) -> Model:
        """Return the model of a case."""
        if name not in self.models:
            self.models[name] = self.method.identify(self.case(name).ensemble)
        return self.models[name]

    def stiffness(self, name: str) -> Array:
        """Return the stiffness of a case, shape (realization, time), known at most times."""
        estimate = self.model(name).estimates.get("stiffness")
        if estimate is None or estimate.axes[-1] != "time":
            raise FailedError("the model has no stiffness over time; give an estimate of it")
        return np.broadcast_to(_mostly_known(estimate.values), self.case(name).stiffness.shape)

    def vaf(self, name: str, model: str = "") -> float:
        """Return the mean VAF in per cent of the noiseless torque of a case."""
        case = self.case(name)
        return _vaf(case.torque, _mostly_known(self.model(model or name).predict(case.ensemble)))


def _identifies(trials: Trials) -> str:
    ensemble, inputs = trials.case("constant").ensemble, trials.method.inputs
    trials.stiffness("constant")
    return (
        f"from {', '.join(['angle', 'torque', *(item.name for item in inputs)])} of "
        f"{len(ensemble)} realizations of {ensemble.duration:g} s at {ensemble.sampling_rate:g} Hz"
    )


def _estimates_what_it_declares(trials: Trials) -> str:
    method, model = trials.method, trials.model("constant")
    pathways = set(model.pathways(trials.case("constant").ensemble))
    declared = {*method.quantities, *method.scheduled_quantities}
    if missing := declared - {*model.estimates} | {*method.pathway_names} - pathways:
        raise FailedError(f"the model lacks {', '.join(sorted(missing))}, which it declares")
    for name, most in method.scheduled_quantities.items():
        count = model.estimates[name].values.size
        _expect(count <= most, f"{name} has {count} values", f"scheduled_quantities says {most}")
    hidden = {*model.estimates} - {*IMPEDANCE, *declared}
    hidden |= pathways - {*method.pathway_names} if len(pathways) > 1 else set()
    advice = "declare quantities, scheduled_quantities or pathway_names, or studies leave them out"
    found = ", ".join([*model.estimates, *sorted(pathways)])
    return f"{', '.join(sorted(hidden))} not declared; {advice}" if hidden else found


def _separates_pathways(trials: Trials) -> str:
    case = trials.case("reflex")
    if "reflex" not in trials.method.pathway_names:
        return "it has no reflex pathway"
    torques = trials.model("reflex").pathways(case.ensemble)
    vaf = {name: _vaf(torque, torques[name]) for name, torque in case.pathways.items()}
    happened = (
        f"VAF {', '.join(f'{each:.1f} % of the {name} torque' for name, each in vaf.items())}"
    )
    return _expect(min(vaf.values()) > 50, happened, "expected more than 50 % of each")


def _recovers_constant(trials: Trials) -> str:
    mean = float(np.nanmean(trials.stiffness("constant")))
    return _expect(
        abs(mean - STIFFNESS) <= 0.1 * STIFFNESS,
        f"{mean:.3g} N·m/rad in the mean, where {STIFFNESS:g} is true",
        "expected at most 10 % off. Are the units rad and N·m? Does a positive torque resist a "
        "positive angle?",
    )


def _predicts(trials: Trials) -> str:
    known, unseen = trials.vaf("constant"), trials.vaf("unseen", "constant")
    return _expect(
        min(known, unseen) > MIN_VAF,
        f"VAF {known:.1f} % of the noiseless torque, {unseen:.1f} % in other data",
        "expected more than 80 %. Does it count viscosity and inertia? Is it aligned in time?",
    )


def _follows_change(trials: Trials) -> str:
    if trials.method.time_invariant:
        return "it takes the joint as constant, and says so (time_invariant)"
    found, truth = trials.stiffness("changing"), trials.case("changing").stiffness
    known = np.isfinite(found)
    found, truth = found[known], truth[known]
    error, spread = float(np.sqrt(np.mean((found - truth) ** 2))), float(truth.std())
    correlation = float(np.corrcoef(found, truth)[0, 1]) if np.ptp(found) > 0 else 0.0
    return _expect(
        correlation > 0.8 and error < spread,
        f"correlation {correlation:.2f} with a sine of ±50 N·m/rad, error {error:.1f} N·m/rad RMS",
        f"expected more than 0.8, and less than the {spread:.1f} of a constant guess. A method "
        "that takes stiffness as constant should say so: time_invariant = True",
    )


def _repeats(trials: Trials) -> str:
    before = trials.stiffness("constant")
    trials.model("changing")
    advice = "give random numbers a fixed seed, and keep nothing from one call to the next"
    return _same(Trials(trials.method).stiffness("constant"), before, advice)


def _reaches_workers(trials: Trials) -> str:
    try:
        copy = cloudpickle.loads(cloudpickle.dumps(trials.method))
    except Exception as error:
        advice = "hold no open file, lock or generator in it"
        raise FailedError(f"cloudpickle: {describe_error(error)}; {advice}") from error
    advice = "keep all settings in the object itself"
    return _same(Trials(copy).stiffness("constant"), trials.stiffness("constant"), advice)


def _scales(trials: Trials) -> str:
    ensemble = trials.case("constant").ensemble
    model = trials.method.identify(attrs.evolve(ensemble, torque=10 * ensemble.torque))
    ratio = float(np.nanmean(model.stiffness) / np.nanmean(trials.model("constant").stiffness))
    advice = "expected 10. Does a threshold or a prior hold for one size of torque only?"
    happened = f"ten times the torque gave {ratio:.3g} times the stiffness"
    return _expect(abs(ratio - 10) < 0.5, happened, advice)


def _other_rate(trials: Trials) -> str:
    mean, vaf = float(np.nanmean(trials.stiffness("other rate"))), trials.vaf("other rate")
    return _expect(
        abs(mean - STIFFNESS) <= 0.15 * STIFFNESS and vaf > MIN_VAF,
        f"at 128 Hz and 1.5 s: {mean:.3g} N·m/rad in the mean, where 100 is true, VAF {vaf:.1f} %",
        "expected at most 15 % off, and a VAF above 80 %. Use ensemble.sampling_rate and "
        "ensemble.samples instead of numbers that hold at 100 Hz and 2 s",
    )


def _without_context(trials: Trials) -> str:
    case = trials.case("without context")
    try:
        stiffness = trials.stiffness("without context")
    except InputError as error:
        return f"refused: {error}"
    predicted = trials.model("without context").predict(case.ensemble)
    edge = round(EDGE_S * case.ensemble.sampling_rate)
    edges = np.r_[:edge, -edge:0]
    largest = np.nanmax(np.abs(stiffness - case.stiffness)[:, edges], initial=0.0)
    vaf = _vaf(case.torque[:, edges], predicted[:, edges])
    return _expect(
        bool(largest <= STIFFNESS / 2) and not vaf <= 50,
        f"NaN at {np.isnan(stiffness).all(axis=0).sum()} of {stiffness.shape[1]} times; within "
        f"0.1 s of the ends, stiffness is up to {largest:.0f} N·m/rad off"
        f"{'' if np.isnan(vaf) else f', VAF {vaf:.0f} %'}",
        "give NaN where lags, windows or derivatives reach beyond the samples",
    )


def _few_realizations(trials: Trials) -> str:
    results = []
    for count in (3, 1):
        few = trials.case("constant").ensemble.select(range(count))
        try:
            trials.method.identify(few).predict(few)
            results.append(f"{count}: a result")
        except InputError as error:
            results.append(f"{count}: refused ({error})")
    return "; ".join(results)


CHECKS: dict[str, tuple[Callable[[Trials], str], bool]] = {  # and whether it is required
    "identifies a joint": (_identifies, True),
    "estimates what it declares": (_estimates_what_it_declares, True),
    "separates intrinsic and reflex torque": (_separates_pathways, False),
    "recovers a constant stiffness": (_recovers_constant, True),
    "predicts the torque": (_predicts, True),
    "follows a changing stiffness": (_follows_change, False),
    "gives the same numbers again": (_repeats, True),
    "can be sent to a worker": (_reaches_workers, True),
    "scales with the torque": (_scales, True),
    "works at another rate and length": (_other_rate, True),
    "works without context": (_without_context, True),
    "takes few realizations, or raises tvsysid.InputError": (_few_realizations, True),
}


def _expect(holds: bool, happened: str, advice: str) -> str:
    """Return what happened, if it is as expected."""
    if not holds:
        raise FailedError(f"{happened}; {advice}")
    return happened


def _vaf(torque: Array, predicted: Array) -> float:
    """Return the mean VAF in per cent; NaN where nothing is predicted."""
    return float(mean_known(metrics.vaf(torque, predicted)))


def _same(values: Array, expected: Array, advice: str) -> str:
    same = np.allclose(values, expected, rtol=1e-9, atol=0.0, equal_nan=True)
    return _expect(same, f"the numbers are {'' if same else 'not '}the same", advice)


def _mostly_known(values: Array) -> Array:
    """Return values of which at most half are NaN."""
    missing = 100 * float(np.mean(np.isnan(values)))
    _expect(
        missing <= 50, f"{missing:.0f} % of the values are NaN", "expected numbers at most times"
    )
    return values


@cache
def simulated_case(
    name: str, inputs: tuple[Input, ...], perturbation: str = "", system: str = ""
) -> Case:
    """Simulate a case with the channels of these inputs, by this perturbation and system."""
    if name == "without context":
        case = simulated_case("other rate", inputs, perturbation, system)
        whole = case.ensemble
        bare = Ensemble(
            whole.angle[:, whole.core],
            whole.torque[:, whole.core],
            whole.sampling_rate,
            channels={each: values[:, whole.core] for each, values in whole.channels.items()},
            recorded_angle=whole.angle_as_recorded[:, whole.core],
        )
        return case._replace(ensemble=bare)
    duration, profile, rate, period, seed = CASES[name]
    joint: simulate.System = simulate.Joint(stiffness=profile)
    if name == "reflex":
        joint = simulate.ReflexJoint(stiffness=profile)
    elif system:
        joint = attrs.evolve(resolve(system, simulate.SYSTEMS, "system"), stiffness=profile)
    elif any(item.kind == "reference" for item in inputs):
        joint = simulate.CompliantActuator(stiffness=profile)
    elif inputs:
        joint = simulate.ScheduledJoint(stiffness=profile)
    kind = resolve(perturbation or "noise", simulate.PERTURBATIONS, "perturbation")
    simulation = joint.simulate(
        duration, perturbation=kind, snr_db=SNR_DB, seed=seed, rate=8 * rate
    )
    names, simulated = [item.name for item in inputs], simulation.recording.channels.values()
    if len(names) > len(simulated):
        raise FailedError(
            f"no simulated joint has all of {', '.join(names)}; a method that is checked can have "
            "one reference, scheduling variable or input"
        )
    channels = dict(zip(names, simulated, strict=False))
    recording = attrs.evolve(simulation.recording, channels=channels)

    def cut(torque: Array) -> Ensemble:
        return segment(decimate(attrs.evolve(recording, torque=torque), rate), period)

    ensemble = cut(recording.torque)
    pathways = {
        each: cut(torque).torque[:, ensemble.core] for each, torque in simulation.pathways.items()
    }
    return Case(ensemble, simulation.truth_of(ensemble)["stiffness"], pathways)
