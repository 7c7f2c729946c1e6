"""Planning: the law that errors follow, what a pilot shows, and what must be recorded."""

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of
from tests.drawing import draw

import tvsysid as tv
from tvsysid.errors import InputError
from tvsysid.planning import Curve, Plan, Protocol, RequiredRecording
from tvsysid.planning.curves import identify_each
from tvsysid.planning.plans import HALF_BAND, MARGIN
from tvsysid.planning.protocol import scatter

COUNTS = np.array([5.0, 20.0, 80.0, 320.0])


def curve(random, bias=0.0):
    return Curve(COUNTS, random, np.full(len(COUNTS), bias))


@pytest.fixture(scope="module")
def planned():
    setup = Protocol(perturbation="prbs", stiffness="square", noise=0.3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Protocol, "sizes", (5, 20, 80))
        setups = [setup, attrs.evolve(setup, amplitude=0.02)]
        return tv.plan(setups, 6.0, 0.1, ["birf", "esm:stiffness=fit"])


def test_law_of_many_realizations_is_found_and_goes_on():
    falls = curve(30 / np.sqrt(COUNTS))
    for count in (5, 30, 320, 2000):
        assert falls.at(count).random == pytest.approx(30 / np.sqrt(count), rel=1e-6)
    # 1.96 * 30 / sqrt(n) <= 6
    assert falls.needed(6 / HALF_BAND, 1000) == 97
    assert falls.needed(6 / HALF_BAND, 96) is None
    assert np.isnan(falls.at(4).random)
    biased = curve(30 / np.sqrt(COUNTS), bias=2.0)
    assert biased.needed(2.5, 1000) == int(np.ceil(900 / (2.5**2 - 2.0**2)))
    assert biased.needed(1.9, 10**4) is None


def test_a_protocol_has_the_noise_and_the_period_that_are_stated():
    setup = Protocol(stiffness="square", noise=0.4, period=1.0)
    made, silent = setup.simulated(40, 3), attrs.evolve(setup, noise=1e-9).simulated(40, 3)
    assert np.std(made.ensemble.torque - silent.ensemble.torque) == pytest.approx(0.4, rel=0.05)
    middle = (np.arange(100) >= 25) & (np.arange(100) < 75)
    np.testing.assert_array_equal(made.stiffness, np.tile(np.where(middle, 150.0, 50.0), (40, 1)))


def test_a_pilot_has_the_joint_the_noise_and_the_movement_of_its_recording():
    ensemble = ensemble_of(80.0, "sine", "noise")
    pilot = Protocol.of(ensemble)
    truth = 100 + 50 * np.sin(np.pi * ensemble.time)
    assert np.sqrt(np.mean((pilot.stiffness_over_time - truth) ** 2)) < 2
    assert pilot.system.viscosity.values.mean() == pytest.approx(2.2, rel=0.05)
    assert pilot.system.inertia == pytest.approx(0.02, rel=0.05)
    more = pilot.simulated(200, 1).ensemble
    assert len(more) == 200
    # The residual is the torque that no joint explains.
    sizes = []
    for each in map(tv.preprocess.subtract_mean, (ensemble, more)):
        residual = each.torque[:, each.core] - tv.BasisIRF().identify(each).predict(each)
        sizes.append([values.std() for values in (each.angle, each.torque, residual)])
    assert sizes[1] == pytest.approx(sizes[0], rel=0.06)


def test_a_pilot_with_a_reversed_torque_is_refused():
    ensemble = ensemble_of(40.0, "sine", "noise")
    with pytest.raises(InputError, match="--torque-sign -1"):
        Protocol.of(attrs.evolve(ensemble, torque=-ensemble.torque))


@pytest.mark.slow
def test_the_reflex_of_a_pilot_is_simulated_and_its_bias_counts():
    # A threshold is exceeded by pulses, hardly by noise of their spectrum.
    reflex = tv.simulate.StretchReflex(threshold=0.3, frequency=10.0)
    joint = tv.simulate.ReflexJoint(tv.simulate.Constant(), reflex_gain=20.0, reflex=reflex)
    pulses = Protocol(joint, None, "pulses", amplitude=0.016, snr_db=25)
    ensemble = pulses.simulated(40, 1).ensemble
    pilot = Protocol.of(ensemble)
    assert pilot.system.reflex_gain.values.mean() == pytest.approx(20, rel=0.15)
    needed = tv.plan(pilot, 8.0, methods=["birf"]).required[0]
    assert "its bias alone is" in needed.why
    stiffness = tv.BasisIRF().identify(tv.preprocess.subtract_mean(ensemble)).stiffness.mean()
    assert needed.bias / HALF_BAND == pytest.approx(stiffness - 100, rel=0.1)


def test_a_pilot_with_another_perturbation_and_amplitude():
    pilot = attrs.evolve(
        Protocol.of(ensemble_of(40.0, "sine", "noise")), amplitude=0.02, perturbation="prbs"
    )
    angle = pilot.simulated(20, 1).ensemble.angle
    assert angle.std() == pytest.approx(0.02, rel=0.1)
    assert np.mean(angle**4) / np.mean(angle**2) ** 2 < 2  # of two levels, 1; of a Gaussian, 3


@pytest.mark.slow
def test_realizations_that_differ_need_more_of_them():
    # Each third realization is of a joint that is half as stiff again: as much scatter as no noise
    # alone gives.
    ensemble = ensemble_of(40.0, "sine", "noise")
    stiffer = np.where(np.arange(len(ensemble)) % 3, 0.0, 50.0)[:, None]
    other = attrs.evolve(ensemble, torque=ensemble.torque + stiffer * ensemble.angle)
    same, differs = (
        tv.plan(each, methods=["birf"]).required[0].excess for each in (ensemble, other)
    )
    assert same < 1.25
    law = attrs.evolve(curve(30 / np.sqrt(COUNTS)), excess=differs)
    assert law.at(20).random == pytest.approx(differs * 30 / np.sqrt(20), rel=1e-6)
    assert 1.6 < differs < 2.4


def test_required_recordings(planned):
    assert len(planned.required) == len(planned.table()) == 4
    slow, fast = planned.required[:2]
    assert slow.realizations is None
    assert "its bias alone is" in slow.why
    assert "to follow a step" in slow.why
    assert fast.method == "esm:stiffness=fit"
    assert str(planned).endswith("no method suffices, of those tried; see why in the table.")
    few, many = (
        planned.curves[setup, "esm:stiffness=fit"].at(80).random
        for setup in reversed(planned.setups)
    )
    assert many / few == pytest.approx(0.02 / Protocol().amplitude, rel=0.15)
    figure = planned.plot()
    draw(figure)
    assert [axes.get_xlabel() for axes in figure.axes][:2] == ["minutes recorded"] * 2


@pytest.mark.parametrize(("context", "period"), [(0.0, 2.0), (0.5, 1.5), (0.5, 0.3)])
def test_a_recording_that_is_planned_holds_its_realizations(context, period):
    protocol = Protocol(period=period, context=context)
    for seconds, holds in ((protocol.seconds(19), True), (protocol.seconds(18), False)):
        signals = np.random.default_rng(0).normal(size=(2, round(100 * seconds)))
        count = len(tv.preprocess.segment(tv.Recording(*signals, 100.0), period, context))
        assert (count == 19) == holds


def test_a_plan_of_few_realizations_names_20():
    needed = RequiredRecording("noise", "birf", 19, 31.5, 4.0, 1.0, 4.1, 0.1)
    plan = Plan(5.0, None, {"noise": Protocol(period=1.5)}, {}, {}, (needed,))
    assert "20 realizations of 1.5 s; record 33 s, because those at both ends are" in str(plan)
    assert str(plan).endswith(
        "19 suffice in simulations, but below 20 real errors are larger: record at least 20."
    )


@pytest.mark.slow
def test_what_is_planned_is_reached():
    steps = []
    plan = tv.plan(
        ensemble_of(40.0, "sine", "noise"),
        8.0,
        methods=["birf"],
        progress=lambda *step: steps.append(step),
    )
    assert steps == [(0, 1), (1, 1)]
    assert plan.best.method == "birf"
    assert f"{max(plan.best.realizations, 20)} realizations of 2 s" in str(plan)
    (needed,), (law,) = plan.required, plan.curves.values()
    assert needed.noise == HALF_BAND * law.at(needed.realizations).random
    assert law.at(needed.realizations).total <= 8 / HALF_BAND / MARGIN
    assert not law.at(needed.realizations - 1).total <= 8 / HALF_BAND / MARGIN
    made = (
        plan.setups[needed.setup].simulated(needed.realizations, 1000 + trial).ensemble
        for trial in range(40)
    )
    reached = HALF_BAND * scatter(identify_each(plan.methods["birf"].identify, made)[0])
    assert reached == pytest.approx(needed.noise, rel=0.15)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"precision": -1}, "precision must be a positive number, got -1"),
        ({"setup": "joint"}, "expected an Ensemble, got str"),
    ],
)
def test_wishes_that_are_none(words, message):
    with pytest.raises(InputError, match=message):
        tv.plan(**{"setup": Protocol(), **words})
