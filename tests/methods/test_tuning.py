import functools
import warnings

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv

METHODS = [
    tv.BasisIRF(),
    pytest.param(tv.KernelRegression(), marks=pytest.mark.slow, id="kbr"),
]


@pytest.fixture(autouse=True)
def _ignore_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tv.DataQualityWarning)
        yield


each_method = pytest.mark.parametrize("method", METHODS, ids=lambda method: method.key)


@functools.cache
def tuned_to_a_square_wave(method):
    return method.tuned(ensemble_of(40.0, "square", "noise"))


@pytest.mark.slow
@each_method
def test_a_tuned_method_is_the_method_with_other_settings_and_the_evidence_for_them(method):
    ensemble = ensemble_of(40.0, "square", "noise")
    tuned, evidence = tuned_to_a_square_wave(method)
    assert tuned == attrs.evolve(method, **evidence.settings)
    # What was tried first are the settings that the method had.
    assert attrs.evolve(method, **evidence.tried[0]) == method
    assert evidence.values[evidence.chosen] == evidence.values.max() or evidence.chosen == 0
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


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (tv.ShortDataSegments(), "ShortDataSegments has no settings that can be chosen"),
        (tv.BasisIRF(prior="none"), "set model to 'parametric', and prior to 'ard' or 'ridge'"),
    ],
)
def test_what_cannot_be_tuned_is_refused(method, message):
    with pytest.raises(tv.InputError, match=message):
        method.tuned(ensemble_of(40.0).select(np.arange(5)))
    with pytest.raises(tv.InputError, match="tuned: expected an Ensemble, got ndarray"):
        method.tuned(np.zeros((10, 200)))


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
    assert tv.methods.parse("birf:max_lag=0.2,tuned=false") == tv.BasisIRF(max_lag=0.2)


# Basis: what samples are worth.


def test_a_basis_is_chosen_by_its_function_not_by_its_size():
    # With noise that lasts, the torque of a person, evidence of as many independent samples asks
    # for every wiggle.
    ensemble = ensemble_of(80.0, "sine", "noise", 40.0)
    random = np.random.default_rng(8)
    steps = np.repeat(random.normal(size=(len(ensemble), 15)), 20, axis=1)
    disturbed = attrs.evolve(ensemble, torque=ensemble.torque + 0.3 * steps)
    assert tv.BasisIRF().tuned(disturbed).method.basis == tv.FourierSeries(1)
