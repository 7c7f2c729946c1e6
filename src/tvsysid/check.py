"""Check your own method on simulated joints of known stiffness."""

from __future__ import annotations

import warnings
from functools import cache, cached_property, partial
from typing import Any

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

CONSTANT, SINE = simulate.Constant(100.0), simulate.SineWave(period=1.5)  # 100 N·m/rad on average
# Duration in s, stiffness, rate in Hz, period and context in s, seed.
CASES: dict[str, tuple[float, simulate.Profile, float, float, float, int]] = {
    "constant": (150.0, CONSTANT, 100.0, 2.0, 0.5, 1),
    "changing": (150.0, simulate.SineWave(), 100.0, 2.0, 0.5, 2),
    "unseen": (40.0, CONSTANT, 100.0, 2.0, 0.5, 3),
    "other rate": (120.0, SINE, 128.0, 1.5, 0.5, 4),
    "no context": (120.0, SINE, 128.0, 1.5, 0.0, 4),
    "reflex": (150.0, CONSTANT, 100.0, 2.0, 0.5, 5),
}
SNR_DB = 30.0
EDGE_S = 0.1
MAX_UNKNOWN = 50.0  # % of values that are NaN
MIN_VAF = 80.0  # % of the noiseless torque


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
    first = cache(partial(Trial, method, "constant"))
    with single_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        for judge in CHECKS:
            name, required = judge.__name__.replace("_", " ").strip(), judge not in RECOMMENDED
            try:
                results.append(Check(name, True, judge(first()), required))
            except (Exception, SystemExit) as error:
                advice = "; work on a copy of it" * ("read-only" in str(error))
                results.append(Check(name, False, f"{describe_error(error)}{advice}", required))
            if not results[0].passed:
                break
    return results


class Trial:
    """A method on one simulated joint, with its true stiffness and noiseless torque by pathway."""

    def __init__(self, method: Method, case: str) -> None:
        self.method = method
        simulated = simulated_case(case, tuple(method.inputs), method.perturbation, method.system)
        self.ensemble, self.truth, self.torques = simulated
        self.on = cache(partial(Trial, method))  # the same method on the joint of another case

    @cached_property
    def model(self) -> Model:
        """Model of the ensemble."""
        return self.method.identify(self.ensemble)

    @cached_property
    def stiffness(self) -> Array:
        """Identified stiffness, shape (realization, time)."""
        estimate = self.model.estimates.get("stiffness")
        if estimate is None or estimate.axes[-1] != "time":
            raise InputError("the model has no stiffness over time; give an estimate of it")
        return np.broadcast_to(_mostly_known(estimate.values), self.truth.shape)

    @property
    def mean(self) -> float:
        """Mean of the identified stiffness."""
        return mean_of(self.stiffness)

    def explained(self, model: Model | None = None, times: Any = slice(None)) -> float:
        """Return the VAF of the noiseless torque by ``model``, or by the model of this ensemble."""
        predicted = _mostly_known((model or self.model).predict(self.ensemble))
        torque = np.asarray(sum(self.torques.values()))
        return mean_of(vaf(torque[:, times], predicted[:, times]))

    def is_repeated(self, method: Method) -> bool:
        """Whether another identification, by a copy of the method, gives the same stiffness."""
        again = Trial(method, "constant").stiffness
        return np.allclose(again, self.stiffness, rtol=1e-9, atol=0.0, equal_nan=True)


def _identifies_a_joint(trial: Trial) -> str:
    ensemble, _ = trial.ensemble, trial.stiffness
    return f"from {', '.join(['angle', 'torque', *ensemble.channels])} of {ensemble!r}"


def _estimates_what_it_declares(trial: Trial) -> str:
    method, model = trial.method, trial.model
    found = [*model.estimates, *model.pathways(trial.ensemble)]
    declared = {*method.quantities, *method.scheduled_quantities, *method.pathway_names}
    missing = ", ".join(sorted(declared - {*found}))
    return _expect(not missing, ", ".join(found), f"the method declares {missing} too")


def _separates_intrinsic_and_reflex_torque(trial: Trial) -> str:
    if "reflex" not in trial.method.pathway_names:
        return "it has no reflex pathway"
    trial = trial.on("reflex")
    torques = trial.model.pathways(trial.ensemble)
    shares = {name: mean_of(vaf(each, torques[name])) for name, each in trial.torques.items()}
    texts = [f"{share:.1f} % of the {name} torque" for name, share in shares.items()]
    happened = f"VAF {', '.join(texts)}"
    return _expect(min(shares.values()) > 50, happened, "expected more than 50 % of each")


def _recovers_a_constant_stiffness(trial: Trial) -> str:
    mean = trial.mean
    return _expect(
        90 <= mean <= 110,
        f"mean {mean:.3g} N·m/rad, true 100",
        "expected at most 10 % off. Are the units rad and N·m? Does a positive torque resist a "
        "positive angle?",
    )


def _predicts_the_torque(trial: Trial) -> str:
    known, unseen = trial.explained(), trial.on("unseen").explained(trial.model)
    return _expect(
        min(known, unseen) > MIN_VAF,
        f"VAF {known:.1f} % of the noiseless torque, {unseen:.1f} % in other data",
        "expected more than 80 %. Does it include viscosity and inertia? Is it aligned in time?",
    )


def _follows_a_changing_stiffness(trial: Trial) -> str:
    if trial.method.time_invariant:
        return "it assumes a constant joint (time_invariant = True)"
    trial = trial.on("changing")
    known = np.isfinite(trial.stiffness)
    found, truth = trial.stiffness[known], trial.truth[known]
    correlation = np.corrcoef(found, truth)[0, 1] if np.ptp(found) > 0 else 0.0
    error, spread = np.sqrt(np.mean((found - truth) ** 2)), truth.std()
    return _expect(
        correlation > 0.8 and error < spread,
        f"correlation {correlation:.2f} with a sine of ±50 N·m/rad, error {error:.1f} N·m/rad RMS",
        f"expected a correlation above 0.8, and an error below {spread:.1f}, that of a constant "
        "guess. A method that assumes a constant joint should have time_invariant = True",
    )


def _gives_the_same_numbers_again(trial: Trial) -> str:
    _ = trial.model, trial.on("changing").model
    same = trial.is_repeated(trial.method)
    advice = "give random numbers a fixed seed, and keep nothing from one call to the next"
    return _expect(same, f"{'the same' if same else 'another'} stiffness the second time", advice)


def _can_be_sent_to_a_worker(trial: Trial) -> str:
    same = trial.is_repeated(cloudpickle.loads(cloudpickle.dumps(trial.method)))
    advice = "keep all settings in the object itself"
    return _expect(same, f"a copy gives {'the same' if same else 'another'} stiffness", advice)


def _scales_with_the_torque(trial: Trial) -> str:
    louder = attrs.evolve(trial.ensemble, torque=10 * trial.ensemble.torque)
    ratio = mean_of(trial.method.identify(louder).stiffness) / trial.mean
    happened = f"ten times the torque gave {ratio:.3g} times the stiffness"
    advice = "expected 10. Does a threshold or a prior hold for one size of torque only?"
    return _expect(9.5 < ratio < 10.5, happened, advice)


def _works_at_another_rate_and_length(trial: Trial) -> str:
    mean, share = trial.on("other rate").mean, trial.on("other rate").explained()
    return _expect(
        85 <= mean <= 115 and share > MIN_VAF,
        f"at 128 Hz and 1.5 s: mean {mean:.3g} N·m/rad, true 100, VAF {share:.1f} %",
        "expected at most 15 % off, and a VAF above 80 %. Use ensemble.sampling_rate and "
        "ensemble.samples instead of numbers that hold at 100 Hz and 2 s",
    )


def _works_without_context(trial: Trial) -> str:
    trial = trial.on("no context")
    try:
        unknown = 100 * np.isnan(trial.model.stiffness).mean()
    except InputError as refusal:
        return f"refused: {refusal}"
    edge = round(EDGE_S * trial.ensemble.sampling_rate)
    edges, error = np.r_[:edge, -edge:0], np.abs(trial.stiffness - trial.truth)
    largest, share = np.nanmax(error[:, edges], initial=0.0), trial.explained(times=edges)
    return _expect(
        largest <= 50 and not share <= 50,  # a VAF of NaN passes
        f"NaN at {unknown:.0f} % of the times; within 0.1 s of the ends, stiffness is up to "
        f"{largest:.0f} N·m/rad off{'' if np.isnan(share) else f', VAF {share:.0f} %'}",
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
    _gives_the_same_numbers_again,
    _can_be_sent_to_a_worker,
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

    The stiffness and the torque of each pathway have the shape (realization, time).
    """
    duration, profile, rate, period, context, seed = CASES[name]
    kinds = {item.kind for item in inputs}
    usual = "compliant" if "reference" in kinds else "scheduled" if kinds else "joint"
    key = "reflex" if name == "reflex" else system or usual
    joint = attrs.evolve(resolve(key, simulate.SYSTEMS, "system"), stiffness=profile)
    kind = resolve(perturbation or "noise", simulate.PERTURBATIONS, "perturbation")
    made = joint.simulate(duration, perturbation=kind, snr_db=SNR_DB, seed=seed, rate=8 * rate)
    channels = dict(
        zip([item.name for item in inputs], made.recording.channels.values(), strict=False)
    )
    if len(channels) < len(inputs):
        raise InputError(
            f"no simulated joint has all of {', '.join(item.name for item in inputs)}; only a "
            "method with one reference, scheduling variable or input can be checked"
        )

    def cut(channels: dict[str, Array]) -> Ensemble:
        recording = attrs.evolve(made.recording, channels=channels)
        return segment(decimate(recording, rate), period, context)

    ensemble, noiseless = cut(channels), cut(made.pathways)
    torques = {name: each[:, ensemble.core] for name, each in noiseless.channels.items()}
    return ensemble, made.truth_of(ensemble)["stiffness"], torques
