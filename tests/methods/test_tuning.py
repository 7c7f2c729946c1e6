import functools
import warnings

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.methods.tuning import halves

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
    # What was tried first are the settings that the method had.
    assert attrs.evolve(method, **evidence.tried[0]) == method
    better = evidence.values.max() if evidence.better == "higher" else evidence.values.min()
    assert evidence.values[evidence.chosen] == better or evidence.chosen == 0
    assert evidence.gain >= 0
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


def test_the_seed_deals_the_halves(few_deals):
    ensemble = ensemble_of(40.0, "sine", "prbs")
    one, other = (tv.EnsembleSpectral().tuned(ensemble, seed).evidence.values for seed in (0, 1))
    assert not np.array_equal(one, other)


# Windows and lags: halves.


def test_halves_tell_the_mean_square_error(random, monkeypatch):
    monkeypatch.setattr(halves, "DEALS", 20)
    truth, noise, count = 10 * np.sin(np.linspace(0, 6, 4000)), 8.0, 60
    torque = truth + noise * random.normal(size=(count, len(truth)))
    pairs = halves.deal(tv.Ensemble(random.normal(size=torque.shape), torque, 100.0), 0)
    means = halves.of_halves(pairs, lambda half: half.torque.mean(axis=0))
    errors = halves.mean_square_errors(np.array([means, 0.5 * means]), means)
    variance = noise**2 / count
    assert errors[:, 0].mean() == pytest.approx(variance, rel=0.1)
    assert errors[:, 1].mean() == pytest.approx(
        0.25 * np.mean(truth**2) + 0.25 * variance, rel=0.05
    )


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


@pytest.mark.parametrize(
    "method",
    [
        tv.ShortDataSegments(window=5.0),
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
    with pytest.raises(tv.InputError, match="seed must be a whole number of 0 or more, got -1"):
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


# Basis: what samples are worth.


def test_a_basis_is_chosen_by_its_function_not_by_its_size():
    # With noise that lasts, the torque of a person, evidence of as many independent samples asks
    # for every wiggle.
    ensemble = ensemble_of(80.0, "sine", "noise", 40.0)
    random = np.random.default_rng(8)
    steps = np.repeat(random.normal(size=(len(ensemble), 15)), 20, axis=1)
    disturbed = attrs.evolve(ensemble, torque=ensemble.torque + 0.3 * steps)
    assert tv.BasisIRF().tuned(disturbed).method.basis == tv.FourierSeries(1)
