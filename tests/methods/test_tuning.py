import functools
import math
import pickle
import warnings

import attrs
import numpy as np
import pytest
from benchmarks import plain
from scipy.signal import butter, lfilter
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.methods import sds
from tvsysid.methods.kbr.record import Record, lagged
from tvsysid.methods.kbr.search import CLEARLY, Candidate, Likelihood
from tvsysid.methods.shared.residuals import independent_share
from tvsysid.methods.tuning import halves
from tvsysid.methods.tuning.evidence import edge_of
from tvsysid.numerics.differentiation import differentiate
from tvsysid.numerics.lowpass import low_pass
from tvsysid.numerics.noise import white_share

METHODS = [
    tv.EnsembleIRF(),
    tv.ShortDataSegments(),
    tv.BasisIRF(),
    tv.EnsembleSpectral(),
    pytest.param(tv.KernelRegression(), marks=pytest.mark.slow, id="kbr"),
]
slow = pytest.mark.slow  # tuning a kernel takes several seconds


@pytest.fixture(autouse=True)
def _doubts_are_not_the_point():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tv.DataQualityWarning)
        yield


@pytest.fixture
def few_deals(monkeypatch):
    """Halves dealt less often, for haste."""
    monkeypatch.setattr(halves, "DEALS", 2)


each_method = pytest.mark.parametrize("method", METHODS, ids=lambda method: method.key)


@functools.cache
def tuned_to_a_square_wave(method):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(halves, "DEALS", 2)  # as few_deals
        return method.tuned(ensemble_of(40.0, "square", "noise"))


@pytest.mark.slow
@each_method
def test_a_tuned_method_is_the_method_with_other_settings_and_the_evidence_for_them(method):
    ensemble = ensemble_of(40.0, "square", "noise")
    tuned, evidence = tuned_to_a_square_wave(method)
    assert tuned == attrs.evolve(method, **evidence.settings)
    assert repr(tuned) == repr(attrs.evolve(method, **evidence.settings))
    assert vars(tuned).keys() == vars(method).keys()  # the evidence is no part of the method
    # What was tried first are the settings that the method had.
    assert attrs.evolve(method, **evidence.tried[0]) == method
    better = evidence.values.max() if evidence.better == "higher" else evidence.values.min()
    assert evidence.values[evidence.chosen] == better or evidence.chosen == 0
    assert tuned.key != "kbr" or (tuned.order, tuned.lag) == (2, 0.0)
    assert evidence.gain >= 0
    assert (
        len(evidence.tried)
        == len(evidence.values)
        == len(evidence.positions)
        == len(evidence.lines)
    )
    table = evidence.to_pandas()
    assert list(table.value) == list(evidence.values)
    assert list(np.flatnonzero(table.chosen)) == [evidence.chosen]
    assert f"{len(evidence.values)} tried" in repr(evidence)
    # It identifies, and no worse than before.
    truth = tv.simulate.SquareWave()(ensemble.time)
    errors = [
        np.sqrt(np.mean((each.identify(ensemble).stiffness - truth) ** 2))
        for each in (method, tuned)
    ]
    assert errors[1] <= 1.05 * errors[0]


@pytest.mark.slow
@each_method
def test_tuning_repeats_and_leaves_its_input_alone(few_deals, method):
    ensemble = ensemble_of(40.0, "square", "noise")
    angle, torque = ensemble.angle.copy(), ensemble.torque.copy()
    first, second = tuned_to_a_square_wave(method), method.tuned(ensemble)
    np.testing.assert_array_equal(first.evidence.values, second.evidence.values)
    assert first.method == second.method
    np.testing.assert_array_equal(ensemble.angle, angle)
    np.testing.assert_array_equal(ensemble.torque, torque)
    again = pickle.loads(pickle.dumps(first))
    np.testing.assert_array_equal(again.evidence.values, first.evidence.values)
    with pytest.raises(ValueError, match="read-only"):
        first.evidence.values[0] = 0


def test_the_seed_deals_the_halves(few_deals):
    ensemble = ensemble_of(40.0, "sine", "prbs")
    one, other = (tv.EnsembleSpectral().tuned(ensemble, seed).evidence.values for seed in (0, 1))
    assert not np.array_equal(one, other)


@slow
@pytest.mark.parametrize(("perturbation", "limit"), [("noise", 1.2), ("prbs", 2.0)])
def test_a_sine_wave_is_followed_nearly_as_if_its_shape_were_known(perturbation, limit):
    truth = tv.simulate.SineWave()
    ensemble = ensemble_of(100.0, "sine", perturbation)
    for method in (tv.BasisIRF(), tv.KernelRegression()):
        model = method.tuned(ensemble).method.identify(ensemble)
        assert np.sqrt(np.mean((model.stiffness - truth(model.time)) ** 2)) < limit


# Kernel regression: the marginal likelihood.


def dense_model(ensemble, theta, decay, near, order=2):
    """Return the covariance of the band's Fourier coefficients, the fixed part, and the output.

    The coefficients are real and imaginary parts. The fixed part has no prior. The fourth value is
    the covariance if nothing changes in time.
    """
    l1, *variances, noise = np.exp(theta)
    signals = differentiate(plain.join(ensemble.angle, ensemble.context, 12), 100.0)[: order + 1]
    torque = plain.join(ensemble.torque, ensemble.context)
    count = len(torque)
    frequency = np.fft.rfftfreq(count, 1 / 100.0)
    inside = frequency <= 20.0 + 1e-9
    apart = np.subtract.outer(np.arange(count), np.arange(count)) / 100.0
    kernel = np.exp(-(np.sin(np.pi * apart / 2.0) ** 2) / l1 - (apart / decay) ** 2)
    place = (np.arange(count) + 0.5) / count
    external = np.cos(np.pi * np.outer(np.arange(5), place))
    changing = sum(
        each * kernel * np.outer(signal, signal)
        for each, signal in zip(variances, signals, strict=False)
    )
    smooth = np.mean(torque**2) * external.T @ external

    def in_band(covariance):
        return plain._fourier(plain._fourier(covariance, inside).T, inside)

    white = np.eye(2 * int(inside.sum()))
    covariance = in_band(changing + noise / near * smooth) + noise * white
    alone = in_band(smooth) + near * white
    return covariance, plain._fourier(signals, inside).T, plain._fourier(torque, inside), alone


def dense_log_density(ensemble, theta, decay, near):
    """Return the restricted log density of the band's Fourier coefficients, but for a constant.

    The kernel is dense.
    """
    covariance, fixed, output, _ = dense_model(ensemble, theta, decay, near)
    inverse = np.linalg.inv(covariance)
    information = fixed.T @ inverse @ fixed
    projected = inverse - inverse @ fixed @ np.linalg.solve(information, fixed.T @ inverse)
    determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1]
    return -0.5 * determinants - output @ projected @ output


@pytest.mark.slow
@pytest.mark.parametrize("decay", [math.inf, 15.0])
def test_marginal_likelihood_is_that_of_the_dense_kernel(decay):
    ensemble = ensemble_of(12.0, "sine", "noise")
    record = Record.of(ensemble, (0.0, 20.0))
    kernel = record.kernel(2.0, 0.05, decay)
    likelihood = Likelihood.of(record, kernel, np.ones((3, kernel.columns), dtype=bool), 0.15)
    one = np.log([0.3, 1600.0, 0.3, 3e-5, 0.15])
    other = np.log([0.1, 650.0, 3.0, 3e-4, 0.2])
    found = likelihood(one)[0] - likelihood(other)[0]
    expected = dense_log_density(ensemble, one, decay, 0.15) - dense_log_density(
        ensemble, other, decay, 0.15
    )
    assert found == pytest.approx(expected, abs=1e-3)
    # Its slope is that of differences.
    _, slope = likelihood(one)
    for number in range(5):
        step = 1e-4 * (np.arange(5) == number)
        difference = (likelihood(one + step)[0] - likelihood(one - step)[0]) / 2e-4
        assert slope[number] == pytest.approx(difference, rel=1e-4, abs=1e-3)


def dense_log_evidence(ensemble, theta, near, order, lag):
    """Return the log density under a proper prior of the constants, but for a constant.

    The price of what is chosen is subtracted.
    """
    covariance, fixed, output, alone = dense_model(
        lagged(ensemble, lag), theta, math.inf, near, order
    )
    count = len(output)
    estimate = np.linalg.lstsq(
        fixed.T @ np.linalg.solve(covariance, fixed),
        fixed.T @ np.linalg.solve(covariance, output),
        rcond=None,
    )[0]
    # As much as one of the numbers tells of the constants, where nothing changes in time.
    prior = count * np.linalg.inv(2 * fixed.T @ np.linalg.solve(alone, fixed))
    whole = covariance / 2 + fixed @ prior @ fixed.T
    left = output - fixed @ estimate
    density = -0.5 * (np.linalg.slogdet(whole)[1] + left @ np.linalg.solve(whole, left))
    return density - 0.5 * (order + 1 + (lag > 0)) * math.log(count)


@pytest.mark.slow
def test_evidence_of_orders_and_lags_is_that_of_the_dense_kernel_with_a_proper_prior():
    ensemble = ensemble_of(12.0, "sine", "noise")
    theta = np.log([0.1, 1600.0, 0.3, 3e-5, 0.15])
    found, expected = [], []
    for lag in (0.0, 0.008):
        record = Record.of(lagged(ensemble, lag), (0.0, 20.0))
        kernel = record.kernel(2.0, 0.1)
        whole = Likelihood.of(record, kernel, np.ones((3, kernel.columns), dtype=bool), 0.15)
        for order in (0, 1, 2):
            part, settings = whole.up_to(order), Candidate(order, lag, math.inf, theta, "")
            found.append(part.compared(settings, theta, part(theta)[0]).value)
            expected.append(dense_log_evidence(ensemble, theta, 0.15, order, lag))
    assert np.ptp(expected) > 100
    np.testing.assert_allclose(
        np.subtract(found, found[0]), np.subtract(expected, expected[0]), atol=0.02
    )


def test_evidence_of_constants_does_not_depend_on_their_units():
    record = Record.of(ensemble_of(20.0, "sine", "noise"), (0.0, 20.0))
    units = np.array([1.0, 100.0, 1e-3, 1.0])[:, None, None]
    stacks = tuple(attrs.evolve(runs, signals=runs.signals * units) for runs in record.stacks)
    other = attrs.evolve(record, stacks=stacks)
    kernel = record.kernel(2.0, 0.1)
    values = []
    for each, variances in ((record, [1600.0, 0.3, 3e-5]), (other, [1600.0, 3e-5, 30.0])):
        likelihood = Likelihood.of(each, kernel, np.ones((3, kernel.columns), dtype=bool), 0.15)
        theta = np.log([0.1, *variances, 0.15])
        settings = Candidate(2, 0.0, math.inf, theta, "")
        values.append(likelihood.compared(settings, theta, likelihood(theta)[0]).value)
    assert values[0] == pytest.approx(values[1], abs=1e-5)


def joint_of(duration, lag=0.0, **settings):
    """Return the ensemble of a simulated joint whose torque passes a lag before the noise.

    The lag is applied at the simulation's rate.
    """
    asked = {"perturbation": tv.simulate.PRBS(), "snr_db": 10, "seed": 1}
    asked |= {name: settings.pop(name) for name in asked if name in settings}
    simulation = tv.simulate.Joint(**{"stiffness": tv.simulate.SineWave()} | settings).simulate(
        duration, **asked
    )
    recording = simulation.recording
    torque = low_pass(simulation.noiseless.torque, lag, 1000.0)
    torque = torque + recording.torque - simulation.noiseless.torque
    behind = tv.Recording(recording.angle, torque, 1000.0, recording.start)
    return tv.preprocess.segment(tv.preprocess.decimate(behind, 100), 2.0, 0.5)


LIGHT = (("inertia", 1e-12),)


@functools.cache
def tuned_to_a_joint(order, joint):
    return tv.KernelRegression(order=order).tuned(joint_of(40, **dict(joint)))


@slow
@pytest.mark.parametrize(
    ("order", "given", "joint"),
    [(2, 0, ()), (1, 2, LIGHT), (1, 0, LIGHT), (0, 2, (*LIGHT, ("viscosity", 0.0)))],
)
def test_as_many_terms_as_the_joint_has(order, given, joint):
    tuned, evidence = tuned_to_a_joint(given, joint)
    assert (tuned.order, tuned.lag) == (order, 0.0)
    assert {f"order {other}" for other in range(3) if other != given} <= set(evidence.lines)


@slow
def test_a_lag_of_the_torque_is_found():
    ensemble = joint_of(40, lag=0.008, perturbation=tv.simulate.FilteredNoise(), snr_db=15)
    given = tv.KernelRegression()
    tuned, evidence = given.tuned(ensemble)
    assert tuned.order == 2
    assert tuned.lag == pytest.approx(0.008, rel=0.2)
    assert f"lag {1e3 * tuned.lag:.3g} ms" in evidence.lines
    without = attrs.evolve(tuned, lag=0.0).identify(ensemble)
    model = tuned.identify(ensemble)
    assert without.viscosity.mean() < 1.8
    assert without.inertia.mean() < 0.012
    assert model.viscosity.mean() == pytest.approx(2.2, rel=0.05)
    assert model.inertia.mean() == pytest.approx(0.02, rel=0.1)
    # One that is given is kept, or goes where there is none.
    assert tv.KernelRegression(lag=tuned.lag).tuned(ensemble).method.lag == tuned.lag
    assert tv.KernelRegression(lag=0.02).tuned(joint_of(20)).method.lag == 0.0


@slow
def test_an_order_or_a_lag_must_be_clearly_better(monkeypatch):
    evidence = tuned_to_a_joint(2, LIGHT).evidence
    gain = evidence.values[evidence.chosen] - max(
        value
        for value, settings in zip(evidence.values, evidence.tried, strict=True)
        if settings["order"] == 2
    )
    assert evidence.settings["order"] == 1
    assert gain > CLEARLY
    monkeypatch.setattr("tvsysid.methods.kbr.search.CLEARLY", gain + 0.1)
    assert tv.KernelRegression().tuned(joint_of(40, **dict(LIGHT))).method.order == 2


@slow
def test_slow_noise_and_a_reflex_do_not_take_the_inertia_away():
    """Test that slow noise does not hide the inertia, where that noise is quiet.

    A share of the numbers, as slow noise leaves it, says too little of inertia.
    """
    reflex = tv.simulate.StretchReflex(0.045, 10.0, 0.8, 0.1)
    joint = tv.simulate.ReflexJoint(
        tv.simulate.Constant(60.0), 1.0, reflex_gain=40.0, reflex=reflex
    )
    recording = joint.simulate(60, perturbation=tv.simulate.Pulses(), snr_db=5, seed=0).recording
    noise = lfilter(
        *butter(1, 1.0, fs=1000), np.random.default_rng(0).standard_normal(len(recording))
    )
    recording = attrs.evolve(
        recording, torque=recording.torque + recording.torque.std() * noise / noise.std()
    )
    ensemble = tv.preprocess.subtract_mean(
        tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    )
    tuned = tv.KernelRegression().tuned(ensemble).method
    assert (tuned.order, tuned.lag) == (2, 0.0)
    assert tuned.identify(ensemble).inertia.mean() > 0.015


def test_a_kernel_that_explains_much_less_than_the_one_given_is_warned_of():
    ensemble = ensemble_of(40.0, "square", "noise")
    with pytest.warns(
        tv.DataQualityWarning, match=r"chosen explain 43 % of the torque, those given 92 %"
    ):
        tv.KernelRegression()._compare(tv.KernelRegression(order=0, gamma=1e-12), ensemble)


def test_what_lies_at_the_edge_of_what_was_tried_is_said_to():
    assert edge_of("window", 0.02, (0.04, 0.02, 0.1)) == (
        "window=0.02 is the smallest that was tried",
    )
    assert edge_of("window", 0.4, (0.04, 0.02, 0.1)) == (
        "window=0.4 is the largest that was tried",
    )
    assert edge_of("window", 0.04, (0.04, 0.02, 0.1)) == edge_of("window", 0.04, (0.04,)) == ()


@slow
@pytest.mark.usefixtures("few_deals")
def test_lags_that_reach_a_slow_answer_are_kept(monkeypatch):
    """The advice on a slow answer is longer lags; tuning judges by the lags that are given."""
    monkeypatch.setattr(sds, "LAGS", (0.03, 0.12))
    monkeypatch.setattr(sds, "WINDOWS", (0.1, 0.4))
    joint = tv.simulate.ReflexJoint(tv.simulate.Constant(100.0), reflex_gain=8.0)
    recording = joint.simulate(
        60, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1
    ).recording
    released = tv.simulate.StretchReflex(direction=-1).torque(
        np.gradient(recording.angle, 1e-3), 8.0, 1000.0
    )
    recording = attrs.evolve(
        recording, torque=recording.torque + released
    )  # with the stretch's, linear
    ensemble = tv.preprocess.subtract_mean(
        tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    )
    (advice,) = tv.diagnose(ensemble).findings
    assert advice.name == "slow-answer"
    assert "sds:max_lag=0.4,window=0.4" in advice.fault.remedy
    tuned, evidence = tv.ShortDataSegments(max_lag=0.4, window=0.4).tuned(ensemble)
    assert tuned.max_lag == 0.4
    assert "max_lag=0.4 is the largest that was tried" in str(evidence)
    assert tuned.identify(ensemble).stiffness.mean() == pytest.approx(100, abs=5)
    assert tv.ShortDataSegments().tuned(ensemble).method.identify(ensemble).stiffness.mean() > 140


@slow
def test_a_joint_that_drifts_keeps_its_decay_with_another_order():
    def profile(time):
        return 100 + 30 * np.sin(np.pi * time) + 0.8 * time

    tuned = (
        tv.KernelRegression()
        .tuned(joint_of(60, stiffness=profile, snr_db=20, inertia=1e-12))
        .method
    )
    assert tuned.order == 1
    assert tuned.length_decay < 300


@slow
def test_chosen_kernel_is_at_the_top_of_the_likelihood():
    ensemble = ensemble_of(40.0, "square", "noise")
    method = tv.KernelRegression()
    evidence = tuned_to_a_square_wave(method).evidence
    settings = evidence.settings
    record = Record.of(ensemble, (0.0, 20.0))
    kernel = record.kernel(2.0, 0.5 * settings["length_periodic"])
    noise, share = method._noise(ensemble)
    likelihood = Likelihood.of(
        record, kernel, np.ones((3, kernel.columns), dtype=bool), noise, share=share
    )
    variances = method._scale(record) ** 2 * np.array(settings["gamma"])
    top = np.log([settings["length_periodic"], *variances, noise])
    best = likelihood.at(Candidate(2, 0.0, math.inf, top, ""))
    assert best.value == pytest.approx(evidence.values[evidence.chosen], abs=0.05)
    for number in range(5):
        for step in (-0.5, 0.5):
            other = best.theta + step * (np.arange(5) == number)
            assert likelihood(other)[0] < likelihood(best.theta)[0] + 0.02


@slow
def test_a_drift_asks_for_a_decay():
    def profile(time):
        return 100 + 30 * np.sin(np.pi * time) + 0.8 * time

    simulation = tv.simulate.Joint(stiffness=profile).simulate(
        60, perturbation=tv.simulate.FilteredNoise(), snr_db=20, seed=3
    )
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), 2.0)
    truth = np.stack([profile(onset + ensemble.time) for onset in ensemble.onsets])
    tuned = tv.KernelRegression().tuned(ensemble).method
    assert tuned.length_decay < 300
    stiffness, _, _ = tuned.identify(ensemble).impedance(ensemble)
    assert np.sqrt(np.mean((stiffness - truth) ** 2)) < 2.5


def test_one_gamma_is_three_alike():
    ensemble = ensemble_of(20.0, "sine", "noise")
    one, three = (
        tv.KernelRegression(gamma=gamma).identify(ensemble) for gamma in (2.0, (2.0, 2.0, 2.0))
    )
    np.testing.assert_array_equal(one.stiffness, three.stiffness)
    stiff = tv.KernelRegression(gamma=(1e-12, 2.0, 2.0)).identify(ensemble)
    assert np.ptp(stiff.stiffness) < 1e-3
    with pytest.raises(tv.InputError, match="one number, or three"):
        tv.KernelRegression(gamma=(1.0, 2.0))
    with pytest.raises(tv.InputError, match="gamma must be a positive number"):
        tv.KernelRegression(gamma=(1.0, 2.0, 0.0))


# Windows and lags: halves.


class Share:
    """Stands for a method: a share of the mean torque, which stands for stiffness."""

    def __init__(self, share):
        self.share = share

    def fit(self, ensemble):
        model = type("Model", (), {})()
        model.stiffness = self.share * ensemble.torque[:, ensemble.core].mean(axis=0)
        return model


def test_halves_tell_the_mean_square_error(random, monkeypatch):
    monkeypatch.setattr(
        halves, "reference_stiffness", lambda half, max_lag: half.torque.mean(axis=0)
    )
    monkeypatch.setattr(halves, "DEALS", 20)
    truth, noise, count = 10 * np.sin(np.linspace(0, 6, 4000)), 8.0, 60
    torque = truth + noise * random.normal(size=(count, len(truth)))
    ensemble = tv.Ensemble(random.normal(size=torque.shape), torque, 100.0)
    compared = halves.Halves(ensemble, 0.1, 0)
    errors = compared.errors(np.array([compared.estimates(Share(share)) for share in (1.0, 0.5)]))
    variance = noise**2 / count
    assert errors[:, 0].mean() == pytest.approx(variance, rel=0.1)
    assert errors[:, 1].mean() == pytest.approx(
        0.25 * np.mean(truth**2) + 0.25 * variance, rel=0.05
    )


@pytest.mark.slow
def test_evidence_is_shown_in_words_and_as_a_table():
    evidence = tuned_to_a_square_wave(tv.ShortDataSegments()).evidence
    shown = evidence._repr_html_()
    assert str(evidence) in shown
    assert shown.count("<tr") == len(evidence.values) + 1
    unchanged = attrs.evolve(evidence, chosen=0)
    assert str(unchanged).startswith(
        "max_lag=0.12, window=0.1 as given: nothing else has a clearly better cross-validated"
    )


def test_halves_are_identified_from_alone():
    ensemble = ensemble_of(40.0, "sine", "noise")
    compared = halves.Halves(ensemble, 0.12, 5)
    method = tv.EnsembleSpectral()
    first, second = (method.fit(half).stiffness for half in compared.halves[0])
    reference = [halves.reference_stiffness(half, 0.12) for half in compared.halves[0]]
    expected = (
        np.mean((first - reference[0]) * (second - reference[1]))
        + np.mean((first - second) ** 2) / 4
    )
    errors = compared.errors(compared.estimates(method)[None])
    assert errors[0, 0] == pytest.approx(expected)
    onsets = np.concatenate([half.onsets for half in compared.halves[0]])
    np.testing.assert_array_equal(np.sort(onsets), ensemble.onsets)


def test_the_reference_is_short_data_segments_with_a_window_that_determines_it():
    ensemble = ensemble_of(40.0, "sine", "noise")  # 20 realizations: 5 samples make 100 for 25 lags
    expected = tv.ShortDataSegments(window=0.04).identify(ensemble).stiffness
    np.testing.assert_allclose(halves.reference_stiffness(ensemble, 0.12), expected)


def test_settings_that_do_not_fit_the_data_are_not_tried(few_deals):
    noise = tv.simulate.FilteredNoise()
    simulation = tv.simulate.Joint(stiffness=tv.simulate.Constant()).simulate(
        30, perturbation=noise, snr_db=10, seed=1
    )
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), 0.3, 0.1)
    tried = tv.ShortDataSegments(max_lag=0.08).tuned(ensemble).evidence.tried
    assert max(settings["window"] for settings in tried) < 0.3


@pytest.mark.slow
def test_settings_are_compared_over_the_times_that_all_of_them_know(few_deals):
    whole = ensemble_of(40.0, "sine", "prbs")
    bare = tv.Ensemble(whole.angle[:, whole.core], whole.torque[:, whole.core], whole.sampling_rate)
    compared = halves.Halves(bare, 0.12, 0)
    narrow, wide = (compared.estimates(tv.EnsembleSpectral(window=window)) for window in (0.3, 0.7))
    known = np.isfinite(wide).all(axis=(0, 1))
    assert known.sum() < np.isfinite(narrow).all(axis=(0, 1)).sum()
    both = compared.errors(np.array([narrow, wide]))
    alone = compared.errors(np.where(known, narrow, np.nan)[None])
    np.testing.assert_allclose(both[:, 0], alone[:, 0])
    evidence = tv.EnsembleSpectral().tuned(bare).evidence
    assert max(settings["window"] for settings in evidence.tried) == 0.7


@pytest.mark.parametrize(
    "method",
    [
        tv.ShortDataSegments(window=5.0),
        tv.ShortDataSegments(max_lag=1.6),
        tv.EnsembleSpectral(window=5.0),
        tv.EnsembleIRF(max_lag=1.6),
    ],
)
def test_settings_given_that_do_not_fit_are_refused_as_by_identification(method):
    ensemble = ensemble_of(40.0)
    for verb in (method.identify, method.tuned):
        with pytest.raises(
            tv.InputError, match=r"\d+ samples.* a realization (has|of) 200 .*give (a )?shorter one"
        ):
            verb(ensemble)


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (tv.ShortDataSegments(), "5 are too few; give at least 8"),
        (tv.BasisIRF(prior="none"), "least squares has no evidence"),
    ],
)
def test_what_cannot_be_tuned_is_refused(method, message):
    with pytest.raises(tv.InputError, match=message):
        method.tuned(ensemble_of(40.0).select(np.arange(5)))
    with pytest.raises(tv.InputError, match="tuned: expected an Ensemble, got ndarray"):
        method.tuned(np.zeros((10, 200)))
    with pytest.raises(tv.InputError, match="seed must be a whole number from 0 on, got -1"):
        method.tuned(ensemble_of(40.0), seed=-1)


# In a study.


def test_a_method_that_tunes_itself():
    ensemble = ensemble_of(40.0, "square", "noise")
    itself = tv.methods.parse("birf:tuned=true")
    assert itself == tv.methods.Tuned(tv.BasisIRF())
    assert (itself.key, itself.title, itself.assumptions) == (
        "birf",
        "Basis impulse response function, tuned",
        tv.BasisIRF.assumptions,
    )
    tuned = tuned_to_a_square_wave(tv.BasisIRF()).method
    model = itself.identify(ensemble)
    np.testing.assert_array_equal(model.stiffness, tuned.identify(ensemble).stiffness)
    assert model.method == repr(tuned)
    assert tv.methods.parse("sds:window=0.2,tuned=false") == tv.ShortDataSegments(window=0.2)
    begun = tv.methods.parse("kbr:preset=experiment,tuned=true").method
    assert begun == tv.KernelRegression.preset("experiment")


@pytest.mark.slow
@pytest.mark.usefixtures("brief_cases")
def test_a_method_that_tunes_itself_keeps_the_contract():
    checks = tv.check_method(tv.methods.Tuned(tv.BasisIRF()))
    assert [f"{check.name}: {check.message}" for check in checks if not check.passed] == []


@pytest.mark.parametrize(
    ("create", "message"),
    [
        (
            lambda: tv.methods.parse("sds:tuned=perhaps"),
            "tuned must be true or false, got 'perhaps'",
        ),
        (lambda: tv.methods.parse("adaptive:tuned=true"), "unknown setting 'tuned'"),
    ],
)
def test_wrong_ways_to_ask_for_tuning_are_refused(create, message):
    with pytest.raises(tv.InputError, match=message):
        create()


# Basis: what samples are worth.


@pytest.mark.parametrize(("alike", "share"), [(1, 1.0), (10, 0.1)])
def test_samples_of_noise_that_lasts_are_worth_less(random, alike, share):
    noise = np.repeat(random.normal(size=(60, 400 // alike)), alike, axis=1)
    slow = np.repeat(random.normal(size=(60, 4)), 100, axis=1)
    ensemble = tv.Ensemble(slow, noise, 100.0)
    worth = independent_share(ensemble, np.zeros_like(noise), (0.0, 50.0))
    # An angle that lasts ten times as long, not for ever, leaves the noise a little more.
    assert share <= worth < 1.4 * share + 0.01
    assert worth == pytest.approx(white_share(noise, slow, 100.0, (0.0, 50.0)))
    edges = np.zeros_like(noise)
    edges[:, :10] = np.nan
    inner = tv.Ensemble(slow[:, 10:], noise[:, 10:], 100.0)
    assert independent_share(ensemble, edges, (0.0, 50.0)) == independent_share(
        inner, edges[:, 10:], (0.0, 50.0)
    )


def test_a_basis_is_chosen_by_its_function_not_by_its_size():
    # With noise that lasts, the torque of a person, evidence of as many independent samples asks
    # for every wiggle.
    ensemble = ensemble_of(80.0, "sine", "noise", 40.0)
    random = np.random.default_rng(8)
    steps = np.repeat(random.normal(size=(len(ensemble), 15)), 20, axis=1)
    disturbed = attrs.evolve(ensemble, torque=ensemble.torque + 0.3 * steps)
    assert tv.BasisIRF().tuned(disturbed).method.basis == tv.FourierSeries(1)
