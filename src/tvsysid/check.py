"""Check your own method on simulated joints of known stiffness."""

from __future__ import annotations

import warnings
from functools import cache, partial

import attrs
import cloudpickle
import numpy as np

from tvsysid import simulate
from tvsysid.errors import DataQualityWarning, InputError, describe_error
from tvsysid.methods import Input, Method, resolve
from tvsysid.metrics import vaf
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_of
from tvsysid.numerics.threads import single_thread
from tvsysid.preprocess import decimate, segment
from tvsysid.signals import Array, Ensemble

SNR_DB = 30.0
EDGE_S = 0.1
MAX_UNKNOWN = 50.0  # % of values that are NaN
MIN_VAF = 80.0  # % of the noiseless torque
MAX_ERROR = 20.0  # N·m/rad RMS


CONSTANT = simulate.Constant(100.0)


@attrs.frozen
class Case:
    """Simulated joint: its random seed, stiffness, and how it is recorded (s, Hz)."""

    seed: int
    stiffness: simulate.Profile = CONSTANT
    duration: float = 150.0
    rate: float = 100.0
    period: float = 2.0
    context: float = 0.5
    system: str = ""


OTHER_RATE = Case(4, simulate.SineWave(period=1.5), 120.0, 128.0, 1.5)  # 100 N·m/rad on average
CASES = {
    "constant": Case(1),
    "changing": Case(2, simulate.SineWave()),
    "unseen": Case(3, duration=40.0),
    "other rate": OTHER_RATE,
    "no context": attrs.evolve(OTHER_RATE, context=0.0),
    "reflex": Case(5, system="reflex"),
}


@attrs.frozen
class Check:
    """Result of one check: its name, whether the method passed, and what happened.

    If the method failed, the message says what to do. A check that is not ``required`` is a
    recommendation.
    """

    name: str
    passed: bool
    message: str
    required: bool


def check_method(method: Method) -> list[Check]:
    """Check a method on simulated joints of known stiffness, which have the channels of its inputs.

    An exception of the method makes a check fail, and is not raised. If the method does not
    identify the first joint, no other check is run.

    Examples
    --------
    >>> from tvsysid.methods import parse
    >>> all(check.passed for check in check_method(parse("sds")))
    True
    """
    results: list[Check] = []
    first = cache(partial(Trial.of, method))
    with single_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        for judge in CHECKS:
            try:
                passed, message = True, judge(first())
            except (Exception, SystemExit) as error:
                passed, message = False, describe_error(error)
            name = judge.__name__.replace("_", " ").strip()
            results.append(Check(name, passed, message, judge not in RECOMMENDED))
            if not results[0].passed:
                break
    return results


@attrs.frozen
class Trial:
    """A method's model of a simulated joint, whose stiffness and noiseless torques are known.

    ``truth`` is the stiffness over time, and each torque has the shape (realization, time).
    """

    method: Method
    ensemble: Ensemble
    truth: Array
    torques: dict[str, Array]
    model: Model

    @classmethod
    def of(cls, method: Method, case: str = "constant") -> Trial:
        """Let a method identify the joint of a case."""
        known = simulated_case(case, tuple(method.inputs), method.perturbation, method.system)
        return cls(method, *known, method.identify(known[0]))

    @property
    def stiffness(self) -> Array:
        """Identified stiffness over time."""
        return _mostly_known(self.model.stiffness)

    def explained(self, model: Model) -> float:
        """Return the VAF of the noiseless torque by a model."""
        torque = np.asarray(sum(self.torques.values()))
        return mean_of(vaf(torque, _mostly_known(model.predict(self.ensemble))))


def _identifies_a_joint(trial: Trial) -> str:
    _ = trial.stiffness
    return f"from {', '.join(['angle', 'torque', *trial.ensemble.channels])} of {trial.ensemble!r}"


def _estimates_what_it_declares(trial: Trial) -> str:
    method, model = trial.method, trial.model
    found = [*model.estimates, *model.pathways(trial.ensemble)]
    declared = {*method.quantities, *method.scheduled_quantities, *method.pathway_names}
    missing = ", ".join(sorted(declared.difference(found)))
    return _expect(not missing, ", ".join(found), f"the method declares {missing} too")


def _separates_intrinsic_and_reflex_torque(trial: Trial) -> str:
    if "reflex" not in trial.method.pathway_names:
        return "it has no reflex pathway"
    trial = Trial.of(trial.method, "reflex")
    found = trial.model.pathways(trial.ensemble)
    share = min(mean_of(vaf(torque, found[name])) for name, torque in trial.torques.items())
    happened = f"VAF {share:.1f} % or more of the torque of each pathway"
    return _expect(share > 50, happened, "expected more than 50 % of each")


def _recovers_a_constant_stiffness(trial: Trial) -> str:
    mean = mean_of(trial.stiffness)
    return _expect(
        90 <= mean <= 110,
        f"mean {mean:.3g} N·m/rad, true 100",
        "expected at most 10 % off. Are the units rad and N·m? Does a positive torque resist a "
        "positive angle?",
    )


def _predicts_the_torque(trial: Trial) -> str:
    share = Trial.of(trial.method, "unseen").explained(trial.model)
    return _expect(
        share > MIN_VAF,
        f"VAF {share:.1f} % of the noiseless torque in other data",
        "expected more than 80 %. Does it include viscosity and inertia? Is it aligned in time?",
    )


def _follows_a_changing_stiffness(trial: Trial) -> str:
    if trial.method.time_invariant:
        return "it assumes a constant joint (time_invariant = True)"
    trial = Trial.of(trial.method, "changing")
    error = np.sqrt(np.nanmean((trial.stiffness - trial.truth) ** 2))
    return _expect(
        error < MAX_ERROR,
        f"error {error:.1f} N·m/rad RMS, with a sine of ±50 N·m/rad",
        "expected less than 20; a constant guess has 35. A method that assumes a constant joint "
        "should have time_invariant = True",
    )


def _gives_the_same_numbers_in_a_worker(trial: Trial) -> str:
    Trial.of(trial.method, "changing")
    again = Trial.of(cloudpickle.loads(cloudpickle.dumps(trial.method))).stiffness
    same = np.allclose(again, trial.stiffness, rtol=1e-9, atol=0.0, equal_nan=True)
    return _expect(
        same,
        f"{'the same' if same else 'another'} stiffness the second time",
        "give random numbers a fixed seed, keep all settings in the object itself, and keep "
        "nothing from one call to the next",
    )


def _scales_with_the_torque(trial: Trial) -> str:
    louder = attrs.evolve(trial.ensemble, torque=10 * trial.ensemble.torque)
    ratio = mean_of(trial.method.identify(louder).stiffness) / mean_of(trial.stiffness)
    happened = f"ten times the torque gave {ratio:.3g} times the stiffness"
    advice = "expected 10. Does a threshold or a prior hold for one size of torque only?"
    return _expect(9.5 < ratio < 10.5, happened, advice)


def _works_at_another_rate_and_length(trial: Trial) -> str:
    trial = Trial.of(trial.method, "other rate")
    mean, share = mean_of(trial.stiffness), trial.explained(trial.model)
    return _expect(
        85 <= mean <= 115 and share > MIN_VAF,
        f"at 128 Hz and 1.5 s: mean {mean:.3g} N·m/rad, true 100, VAF {share:.1f} %",
        "expected at most 15 % off, and a VAF above 80 %. Use ensemble.sampling_rate and "
        "ensemble.samples instead of numbers that hold at 100 Hz and 2 s",
    )


def _works_without_context(trial: Trial) -> str:
    try:
        trial = Trial.of(trial.method, "no context")
    except InputError as refusal:
        return f"refused: {refusal}"
    edge = round(EDGE_S * trial.ensemble.sampling_rate)
    error = np.abs(trial.stiffness - trial.truth)[np.r_[:edge, -edge:0]]
    largest = np.nanmax(error, initial=0.0)
    return _expect(
        largest <= 50,
        f"within 0.1 s of the ends, stiffness is up to {largest:.0f} N·m/rad off",
        "give NaN where lags, windows or derivatives reach beyond the samples",
    )


def _takes_or_refuses_few_realizations(trial: Trial) -> str:
    results = []
    for count in (3, 1):
        few = trial.ensemble.select(range(count))
        try:
            trial.method.identify(few).predict(few)
            results.append(f"{count}: a result")
        except InputError as error:
            results.append(f"{count}: refused ({error})")
    return "; ".join(results)


CHECKS = (
    _identifies_a_joint,
    _estimates_what_it_declares,
    _separates_intrinsic_and_reflex_torque,
    _recovers_a_constant_stiffness,
    _predicts_the_torque,
    _follows_a_changing_stiffness,
    _gives_the_same_numbers_in_a_worker,
    _scales_with_the_torque,
    _works_at_another_rate_and_length,
    _works_without_context,
    _takes_or_refuses_few_realizations,
)
RECOMMENDED = (_separates_intrinsic_and_reflex_torque, _follows_a_changing_stiffness)


def _expect(holds: bool, happened: str, advice: str) -> str:
    """Return the message ``happened``. If the check does not hold, raise with it and advice."""
    if not holds:
        raise InputError(f"{happened}; {advice}")
    return happened


def _mostly_known(values: Array) -> Array:
    """Return values, or raise if too many of them are NaN."""
    if (unknown := 100 * np.isnan(values).mean()) > MAX_UNKNOWN:
        raise InputError(f"{unknown:.0f} % of the values are NaN; expected numbers at most times")
    return values


@cache
def simulated_case(
    name: str, inputs: tuple[Input, ...], perturbation: str, system: str
) -> tuple[Ensemble, Array, dict[str, Array]]:
    """Simulate a case: an ensemble with channels for inputs, true stiffness, noiseless torques.

    The stiffness is the mean over realizations, shape (time,). Torques have the shape
    (realization, time).
    """
    case, kinds = CASES[name], {item.kind for item in inputs}
    usual = "compliant" if "reference" in kinds else "scheduled" if kinds else "joint"
    joint = resolve(case.system or system or usual, simulate.SYSTEMS, "system")
    made = attrs.evolve(joint, stiffness=case.stiffness).simulate(
        case.duration,
        perturbation=resolve(perturbation or "noise", simulate.PERTURBATIONS, "perturbation"),
        snr_db=SNR_DB,
        seed=case.seed,
        rate=8 * case.rate,
    )
    names = [item.name for item in inputs]
    channels = dict(zip(names, made.recording.channels.values(), strict=False))
    every = attrs.evolve(made.recording, channels=channels | dict(made.pathways))
    cut = segment(decimate(every, case.rate), case.period, case.context)
    ensemble = attrs.evolve(cut, channels={name: cut.channels[name] for name in channels})
    torques = {name: cut.channels[name][:, cut.core] for name in made.pathways}
    return ensemble, made.truth_of(ensemble)["stiffness"].mean(axis=0), torques
