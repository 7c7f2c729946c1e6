"""What every method must do, whatever its kind."""

import functools
import pickle
import warnings

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of, standard_errors_of
from tests.contracts.toys import TOYS
from threadpoolctl import threadpool_info, threadpool_limits

import tvsysid as tv

METHODS = {
    "eirf": tv.EnsembleIRF(),
    "sds": tv.ShortDataSegments(),
    "birf": tv.BasisIRF(),
    "birf irf": tv.BasisIRF(model="irf"),
    "birf irf ridge": tv.BasisIRF(model="irf", prior="ridge"),
    "esm": tv.EnsembleSpectral(),
    "esm fit": tv.EnsembleSpectral(stiffness="fit"),
    "kbr": tv.KernelRegression(),
    "kbr experiment": tv.KernelRegression(length_decay=30.0),
    "pc": tv.ParallelCascade(),
    "adaptive": tv.AdaptiveRegression(),
    "cascade": tv.JointCascade(),
    "tvpc": tv.EnsembleCascade(),
    "bpc": tv.BasisCascade(),
    "sdss": tv.SubspaceCascade(terms=3),
}
FOLLOWING = [name for name, method in METHODS.items() if not method.time_invariant]
# Pathways that are identified in turn have no bands: their authors state none.
BANDED = [name for name in METHODS if name.partition(" ")[0] not in {"pc", "tvpc", "bpc"}]
# Samples at either end that cannot be estimated without context, if not 12
REACH = {"esm": (15, 14), "esm fit": (15, 14)}
REACH |= {"cascade": (45, 4), "sdss": (4, 4)}
# Methods of other data than those of all other tests
OTHER_DATA = (
    tv.ScheduledIRF,
    tv.ScheduledImpedance,
    tv.SkirtDecomposition,
    tv.ModalDecomposition,
)
# Methods whose checks take seconds
SECONDS = ("kbr experiment", "cascade", "sdss", "tvpc", "bpc")


def parametrize(*names):
    chosen = {name: pytest.mark.slow if name in SECONDS else () for name in names or METHODS}
    return pytest.mark.parametrize(
        "method",
        [pytest.param(METHODS[name], id=name, marks=marks) for name, marks in chosen.items()],
    )


@pytest.fixture(scope="module")
def brief_cases():
    """Halve the joints that `check_method` simulates: as much is expected, of fewer data."""
    from tvsysid import check

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(check, "DURATION_S", check.DURATION_S / 2)
        yield


@pytest.fixture(autouse=True)
def _ignore_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tv.DataQualityWarning)
        yield


def name_of(method):
    return next(name for name, each in METHODS.items() if each is method)


def enough_for(method):
    return {"kbr": 20.0, "eirf": 150.0}.get(method.key, 60.0), "sine", "prbs"


def duration_for(method):
    """What is alone at each time needs more realizations than what is smooth over time."""
    return 150.0 if method.key in {"eirf", "pc", "tvpc"} else 80.0


@functools.cache
def model_of(method, *data):
    """Model from `ensemble_of(*data)`; nothing may change it."""
    return method.identify(ensemble_of(*data))


EVERY = {name: (each, name in SECONDS) for name, each in METHODS.items() if " " not in name}
EVERY |= {other.key: (other(), True) for other in OTHER_DATA}
EVERY |= {toy.__name__: (toy(), False) for toy in TOYS}


@pytest.mark.parametrize(
    "method",
    [
        pytest.param(method, id=name, marks=[pytest.mark.slow] * is_slow)
        for name, (method, is_slow) in EVERY.items()
    ],
)
@pytest.mark.usefixtures("brief_cases")
def test_every_method_passes_every_check(method):
    checks = tv.check_method(method)
    assert [f"{check.name}: {check.message}" for check in checks if not check.passed] == []


@parametrize()
def test_result_is_whole_and_immutable(method):
    model = model_of(method)
    for name in ("stiffness", "viscosity", "inertia"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(model, name)[0] = 0.0
    assert np.isfinite(model.stiffness).all()
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        model.stiffness = None
    assert model.diagnostics.parameters > 0
    assert model.diagnostics.seconds > 0
    assert type(method).__name__ in repr(model)
    assert tv.methods.METHODS[method.key] is type(method)


@parametrize()
def test_constant_stiffness_is_recovered_from_noiseless_data(method):
    ensemble = ensemble_of(duration_for(method), "constant", "noise", np.inf)
    model = method.identify(ensemble)
    # The 0-Hz estimate of short windowed segments is known to lie 2 to 3 N·m/rad low.
    allowed = 4.0 if method.key == "esm" else 1.0
    assert np.abs(model.stiffness - 100.0).mean() < allowed


@parametrize(
    *(name for name in METHODS if name != "sdss")
)  # a stiffness that changes is a reflex to it
@pytest.mark.parametrize(
    ("profile", "perturbation"), [("sine", "noise"), ("sine", "prbs"), ("square", "prbs")]
)
def test_viscosity_and_inertia_are_recovered(method, profile, perturbation):
    model = model_of(method, duration_for(method), profile, perturbation)
    assert np.mean(model.viscosity) == pytest.approx(2.2, rel=0.05)
    assert np.mean(model.inertia) == pytest.approx(0.02, rel=0.05)
    if method.key != "cascade":  # which compares two stiffnesses instead
        assert 99 < model.diagnostics.details["second_order_agreement"] <= 100


@parametrize(*BANDED)
def test_every_method_answers_bands(method):
    model = model_of(method, duration_for(method), "sine", "prbs")
    for name in ("stiffness", "viscosity", "inertia"):
        estimate, (lower, upper) = getattr(model, name), model.estimates[name].band()
        np.testing.assert_array_equal(
            (lower < estimate) & (estimate < upper), np.isfinite(estimate)
        )
    whole, pointwise = (model.estimates["stiffness"].band(simultaneous=each) for each in (1, 0))
    # For a constant, simultaneous and pointwise bands agree
    wider = np.isclose if method.time_invariant else np.greater
    known = np.isfinite(model.stiffness)
    assert wider(pointwise[0], whole[0])[known].all()
    assert wider(whole[1], pointwise[1])[known].all()


@parametrize(*FOLLOWING)
def test_the_sine_is_traced_and_other_data_of_the_joint_are_predicted(method):
    shaken, noisy = (
        method.identify(ensemble_of(duration_for(method), "sine", each, 20.0))
        for each in ("prbs", "noise")
    )
    error = shaken.stiffness - tv.simulate.SineWave()(shaken.time)
    assert np.sqrt(np.mean(error**2)) < 6.0
    other = ensemble_of(40.0, "sine", "noise", 20.0, seed=5)
    predicted = noisy.predict(other)
    assert tv.metrics.vaf(other.torque[:, other.core], predicted).mean() > 94


@parametrize()
def test_without_context_edges_are_not_invented(method):
    whole = ensemble_of(40.0)
    bare = tv.Ensemble(whole.angle[:, whole.core], whole.torque[:, whole.core], whole.sampling_rate)
    if reason := method.skip(bare):
        assert "cut with more context" in reason
        return
    model = method.identify(bare)
    early, late = REACH.get(name_of(method), (12, 12))
    known = np.isfinite(model.stiffness)
    assert not known[:early].any()
    assert not known[-late:].any()
    assert known[early:-late].all()
    predicted = np.isfinite(model.predict(bare)).all(axis=0)
    last = round(getattr(model, "reflex_lags", [0.0])[-1] * bare.sampling_rate)
    early = max(early, last - getattr(model, "optional_lags", 0))
    assert predicted[early : -late - 1].all()
    assert not predicted[:early].any()
    assert not predicted[-late:].any()


@parametrize("eirf", "sds", "esm", "birf", "birf irf", "kbr")
def test_more_context_than_needed_changes_nothing(method):
    # Segments of 0.15 s to either side, and derivatives of 0.12 s beyond.
    long, short = ensemble_of(40.0, context=0.9), ensemble_of(40.0, context=0.3)
    assert len(long) == len(short)
    models = [method.identify(each) for each in (long, short)]
    for name in ("stiffness", "viscosity", "inertia"):
        one, other = (getattr(model, name) for model in models)
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)


# What rounding does where a prior hardly holds inertia, iterations end, or products of columns are
# factored (sdss)
ROUNDING = dict.fromkeys(("kbr experiment", "pc", "bpc"), 1e-6)
ROUNDING |= {"birf irf ridge": 1e-7, "sdss": 1e-5}


@parametrize()
@pytest.mark.parametrize(("torque", "angle"), [(25, -25), (-25, 24.7), (-3.3, -1.76)])
def test_units_of_torque_and_angle_scale_the_impedance_and_change_nothing_else(
    method, torque, angle
):
    ensemble, model = ensemble_of(*enough_for(method)), model_of(method, *enough_for(method))
    angles = {name: getattr(ensemble, name) * 10**angle for name in ("angle", "recorded_angle")}
    scaled = attrs.evolve(ensemble, torque=ensemble.torque * 10**torque, **angles)
    other, factor = method.identify(scaled), 10**torque / 10**angle
    rounding = ROUNDING.get(name_of(method), 1e-9)
    for name in ("stiffness", "viscosity", "inertia"):
        expected = getattr(model, name) * factor
        atol = rounding * np.nanmax(np.abs(expected))
        np.testing.assert_allclose(getattr(other, name), expected, rtol=1e-9, atol=atol)
    np.testing.assert_allclose(
        standard_errors_of(other), standard_errors_of(model) * factor, rtol=rounding
    )


@parametrize()
def test_order_of_realizations_does_not_matter(method, random):
    ensemble, model = ensemble_of(*enough_for(method)), model_of(method, *enough_for(method))
    for order in (range(len(ensemble))[::-1], random.permutation(len(ensemble))):
        other = method.identify(ensemble.select(order))
        # Sums in another order differ by rounding, which iterations to a tolerance may carry
        # further.
        np.testing.assert_allclose(other.stiffness, model.stiffness, rtol=1e-3)


def test_anything_but_an_ensemble_that_fits_is_refused():
    with pytest.raises(tv.InputError, match="identify: expected an Ensemble, got ndarray"):
        tv.ShortDataSegments().identify(np.zeros((10, 200)))
    model = model_of(tv.ShortDataSegments())
    with pytest.raises(tv.InputError, match=r"200 samples at 100 Hz, the ensemble 100 at 100 Hz"):
        model.predict(ensemble_of(40.0, period=1.0))
    with pytest.raises(tv.InputError, match=r"expected an Ensemble, got Recording; cut"):
        model.predict(tv.Recording(np.arange(200.0), np.arange(200.0), 100.0))


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (tv.EnsembleIRF(max_lag=3.0), "601 samples"),
        (tv.ShortDataSegments(window=5.0), "longer than a realization"),
        (tv.EnsembleSpectral(window=5.0), "500 samples"),
        (tv.EnsembleIRF(max_lag=0.001), "less than one sample"),
        (tv.EnsembleSpectral(window=0.01), "at least 0.04 s"),
        (tv.KernelRegression(band=(60.0, 70.0)), "lower band"),
    ],
)
def test_settings_that_do_not_fit_the_data_are_refused(method, message):
    with pytest.raises(tv.InputError, match=message):
        method.identify(ensemble_of())


def test_a_callable_basis_serves():
    method = tv.BasisIRF(
        basis=lambda time: np.stack([np.ones_like(time), np.sin(2 * np.pi * time)], axis=1)
    )
    model = method.identify(ensemble_of(150.0, "sine", "noise", 20.0))
    assert np.abs(model.stiffness - tv.simulate.SineWave()(model.time)).max() < 5


@parametrize()
def test_a_model_that_travels_takes_its_bands_along_and_not_the_data(method):
    model = model_of(method, *enough_for(method))
    travelled = pickle.loads(pickle.dumps(model))
    for one, other in zip(
        model.estimates["stiffness"].band(), travelled.estimates["stiffness"].band(), strict=True
    ):
        np.testing.assert_array_equal(one, other)
    assert travelled.diagnostics.details.keys() == model.diagnostics.details.keys()


def test_blas_has_one_thread_within_a_method_and_as_many_as_before_after_it(monkeypatch):
    def threads():
        return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    seen, own = [], tv.ShortDataSegments.fit
    monkeypatch.setattr(
        tv.ShortDataSegments, "fit", lambda *given: seen.append(threads()) or own(*given)
    )
    with threadpool_limits(2):
        before = threads()
        tv.ShortDataSegments().identify(ensemble_of())
        assert threads() == before
    assert seen == [{1}] != [before]
