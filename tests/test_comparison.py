"""Several methods on one ensemble, and predictions of realizations that were held out."""

import pickle

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of, realizations

import tvsysid as tv


class Level(tv.Method):
    """Needs a channel."""

    inputs = (tv.Input("emg", "scheduling", "V"),)

    def fit(self, ensemble):
        return tv.Model.of(ensemble, ensemble.signal("emg")[:, ensemble.core].mean(axis=0))


class Unused(tv.Method):
    def fit(self, ensemble):
        raise ZeroDivisionError("by zero")


def test_it_gives_the_same_as_each_method_by_itself():
    ensemble = ensemble_of()
    found = tv.compare(ensemble, ["sds", tv.BasisIRF()])
    assert list(found.models) == ["sds", repr(tv.BasisIRF())]
    alone = tv.ShortDataSegments().identify(ensemble)
    np.testing.assert_array_equal(found.models["sds"].stiffness, alone.stiffness)
    torque = ensemble.torque[:, ensemble.core]
    np.testing.assert_array_equal(found.vaf["sds"], tv.metrics.vaf(torque, alone.predict(ensemble)))
    table = found.over_time()
    upper = table[table.method == "sds"].viscosity_upper
    np.testing.assert_array_equal(upper, alone.estimates["viscosity"].band()[1])
    assert pickle.loads(pickle.dumps(found)).over_time().equals(table)


@pytest.mark.parametrize(
    ("methods", "message"),
    [
        ([Level()], "needs the channel 'emg' .scheduling, V."),
        ([Unused()], r"^Unused: ZeroDivisionError: by zero \(test_comparison.py, line"),
        ([Unused(), Unused()], "two methods have the name Unused"),
    ],
)
def test_methods_that_cannot_be_compared(methods, message):
    with pytest.raises(tv.InputError, match=message):
        tv.compare(ensemble_of(), methods)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")
def test_by_default_other_methods_check_adaptive():
    assert list(tv.compare(ensemble_of(20.0)).models) == ["adaptive", "sds"]
    assert list(tv.compare(ensemble_of(4.0, context=0.0)).models) == ["cascade"]
    joint = tv.simulate.ReflexJoint(stiffness=tv.simulate.Constant(100.0), reflex_gain=8.0)
    recording = joint.simulate(
        40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1
    ).recording
    ensemble = realizations(recording)
    assert list(tv.compare(ensemble).models) == ["adaptive", "cascade", "sdss"]


@pytest.mark.slow
def test_held_out_vaf_is_that_of_the_raw_data_less_means_of_the_other_realizations():
    raw = ensemble_of(120.0)
    drift = np.sin(np.arange(raw.torque.shape[1]) / 20)
    raw = attrs.evolve(raw, torque=raw.torque + drift, angle=raw.angle + 1)
    found, calls = tv.compare(tv.preprocess.subtract_mean(raw), ["sds", "birf"]), []
    torques = found.predict_held_out(4, progress=lambda *done: calls.append(done))
    held_out = {label: tv.metrics.vaf(*each) for label, each in torques.items()}
    assert calls == [(number, 8) for number in range(8)]
    for part in np.array_split(np.arange(len(raw)), 4):
        kept, left = raw.select(np.setdiff1d(np.arange(len(raw)), part)), raw.select(part)
        angle, torque = (
            left.signal(name) - kept.signal(name).mean(axis=0) for name in ("angle", "torque")
        )
        left = attrs.evolve(left, angle=angle, torque=torque)
        for label, method in found.methods.items():
            model = method.identify(tv.preprocess.subtract_mean(kept))
            expected = tv.metrics.vaf(left.torque[:, left.core], model.predict(left))
            np.testing.assert_allclose(held_out[label][part], expected, atol=1e-8)


class Watched(tv.Method):
    """Keeps the ensembles that it identifies and predicts."""

    def __init__(self):
        self.seen = []

    def fit(self, kept):
        def predict(every):
            self.seen.append((kept, every))
            return {"intrinsic": np.zeros((len(every), every.samples))}

        return tv.Model.of(kept, 100.0, pathways=predict)


def test_a_method_sees_nothing_of_the_torque_that_is_held_out():
    method = Watched()
    found = tv.compare(tv.preprocess.subtract_mean(ensemble_of(80.0)), [method])
    assert not found.held_out_vaf["Watched"].any()
    parts = np.array_split(np.arange(40), 5)
    for (kept, every), part in zip(method.seen[1:], parts, strict=True):
        np.testing.assert_array_equal(kept.onsets, np.delete(found.ensemble.onsets, part))
        means = [kept.angle.mean(axis=0), kept.torque.mean(axis=0)]
        np.testing.assert_allclose(means, 0, atol=1e-13)
        assert not every.torque[part].any()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*do not determine whether there is a stretch reflex")
def test_a_method_that_cannot_identify_without_a_fold_has_no_held_out_vaf():
    ensemble = tv.preprocess.subtract_mean(ensemble_of(20.0).select([0, 1, 2, 3]))
    found = tv.compare(ensemble, ["adaptive", "kbr"])
    with pytest.warns(tv.DataQualityWarning, match="adaptive: no held-out VAF .* at least 4 real"):
        held_out = found.held_out_vaf
    assert np.isnan(held_out["adaptive"]).all()
    assert np.isfinite(held_out["kbr"]).all()
    two = attrs.evolve(found, ensemble=ensemble.select([0, 1]))
    assert np.isnan(two.held_out_vaf["kbr"]).all()
