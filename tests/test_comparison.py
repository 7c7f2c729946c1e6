"""Several methods on one ensemble."""

import copy
import pickle

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.models import Diagnostics


def model_of(ensemble, estimates, **coordinates):
    def pathways(other):
        angle = other.angle[:, other.core]
        return {"intrinsic": 80 * angle, "reflex": 20 * angle}

    return tv.Model.of(ensemble, estimates=estimates, pathways=pathways, coordinates=coordinates)


class Level(tv.Method):
    """Reads the scheduling channel and says that stiffness is that."""

    inputs = (tv.Input("emg", "scheduling", "V"),)

    def fit(self, ensemble):
        values = ensemble.signal("emg")[:, ensemble.core]

        error = tv.StandardError(np.ones(ensemble.samples), 9)
        return model_of(
            ensemble,
            {
                "stiffness": tv.Estimate(values, "N m/rad", axes=("realization", "time")),
                "offset": tv.Estimate(values.mean(axis=0), "V", error=error),
            },
        )

    def __repr__(self):
        return "Level()"


def test_it_gives_what_each_method_gives_by_itself():
    ensemble = ensemble_of()
    found = tv.compare(ensemble, ["sds", tv.BasisIRF()])
    assert list(found.models) == ["sds", repr(tv.BasisIRF())]
    alone = tv.ShortDataSegments().identify(ensemble)
    np.testing.assert_array_equal(found.models["sds"].stiffness, alone.stiffness)
    np.testing.assert_array_equal(
        found.bands["sds"]["stiffness"], alone.estimates["stiffness"].band()
    )
    torque = ensemble.torque[:, ensemble.core]
    np.testing.assert_array_equal(found.vaf["sds"], tv.metrics.vaf(torque, alone.predict(ensemble)))
    table = found.over_time()
    assert len(table) == 2 * ensemble.samples
    np.testing.assert_array_equal(
        table[table.method == "sds"].viscosity_upper, found.bands["sds"]["viscosity"][1]
    )
    row = found.summary().iloc[0]
    assert row["stiffness (N·m/rad)"] == pytest.approx(alone.stiffness.mean())
    assert row["lowest (N·m/rad)"] == alone.stiffness.min()


def test_a_method_that_lacks_its_channel_is_skipped_and_the_others_go_on():
    found = tv.compare(ensemble_of(), [Level(), "sds"])
    assert list(found.models) == ["sds"]
    assert (
        "needs the channel 'emg' (scheduling, V), the ensemble has no further channel"
        in found.skipped["Level()"]
    )
    with pytest.raises(tv.InputError, match="needs the channel 'emg'"):
        tv.compare(ensemble_of(), [Level()])
    with pytest.raises(tv.InputError, match="needs the channel 'emg'"):
        Level().identify(ensemble_of())


def test_any_quantity_and_any_pathway_comes_through():
    ensemble = ensemble_of()
    shape = ensemble.angle.shape
    with_emg = tv.Ensemble(
        ensemble.angle,
        ensemble.torque,
        100.0,
        ensemble.context,
        channels={"emg": np.full(shape, 100.0)},
    )
    found = tv.compare(with_emg, [Level()])
    model = found.models["Level()"]
    np.testing.assert_array_equal(model.stiffness, 100.0)
    assert list(model.pathways(with_emg)) == ["intrinsic", "reflex"]
    np.testing.assert_allclose(
        model.predict(with_emg), 100 * with_emg.angle[:, with_emg.core], rtol=1e-12
    )
    table = found.over_time()
    assert (table.offset_upper > table.offset).all()
    assert np.isnan(table.stiffness_upper).all()
    dataset = model.to_xarray(with_emg)
    assert dataset.stiffness.dims == ("realization", "time")
    assert dataset.torque_reflex.attrs["units"] == "N m"
    assert dataset.offset_lower.attrs["units"] == "V"


def test_an_error_of_a_plugin_names_its_place():
    class Broken(tv.Method):
        def fit(self, ensemble):
            raise ZeroDivisionError("by zero")

    with pytest.raises(
        tv.InputError, match=r"method Broken: ZeroDivisionError: by zero \(test_comparison.py, line"
    ):
        tv.compare(ensemble_of(), [Broken()])


def test_settings_are_chosen_from_the_data_if_asked():
    found = tv.compare(ensemble_of(80.0), ["birf"], tune=True)
    assert found.evidence["birf"].settings == {"basis": found.methods["birf"].basis}
    assert not tv.compare(ensemble_of(), ["adaptive"], tune=True).evidence


class OnlyStiffness(tv.Method):
    def fit(self, ensemble):
        raise AssertionError


def test_two_methods_of_one_name_are_refused_and_none_is_told():
    with pytest.raises(tv.InputError, match="two methods have the name OnlyStiffness"):
        tv.compare(ensemble_of(), [OnlyStiffness(), OnlyStiffness()])
    assert list(tv.compare(ensemble_of(), ["esm", "esm"]).models) == ["esm"]
    with pytest.raises(tv.InputError, match="expected at least one method, got none"):
        tv.compare(ensemble_of(), [])


def test_an_error_of_skip_names_its_place():
    class Broken(OnlyStiffness):
        def skip(self, ensemble):
            return {}["reason"]

    with pytest.raises(
        tv.InputError, match=r"method Broken: KeyError: 'reason' \(test_comparison.py, line"
    ):
        tv.compare(ensemble_of(), [Broken()])


def test_a_channel_either_keeps_its_mean_or_loses_it():
    class Driven(OnlyStiffness):
        inputs = (tv.Input("emg", "input", "V"),)

    assert tv.methods.deviating_channels([Driven(), OnlyStiffness()]) == ("emg",)
    with pytest.raises(tv.InputError, match="channel 'emg' keeps its mean for one method"):
        tv.methods.deviating_channels([Driven(), Level()])


def test_it_can_be_pickled_and_copied():
    found = tv.compare(ensemble_of(), ["sds"])
    for again in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found)):
        assert again.over_time().equals(found.over_time())


def test_names_in_a_dataset_are_told_apart():
    class Confused(Level):
        inputs = ()

        def fit(self, ensemble):
            values = ensemble.angle[:, ensemble.core]
            error = tv.StandardError(np.ones(ensemble.samples), 9)
            names = {
                "stiffness": ("realization", "time"),
                "offset": ("time",),
                "offset_lower": ("time",),
            }
            return model_of(
                ensemble,
                {
                    name: tv.Estimate(
                        values if axes[1:] else values[0], "V", axes, None if axes[1:] else error
                    )
                    for name, axes in names.items()
                },
            )

    ensemble = ensemble_of()
    with pytest.raises(tv.InputError, match="two variables have the name 'offset_lower'"):
        Confused().identify(ensemble).to_xarray()
    model = Level().identify(attrs.evolve(ensemble, channels={"emg": ensemble.torque}))
    with pytest.raises(
        tv.InputError, match=r"the model tells 20 realizations apart, the ensemble has 3"
    ):
        model.to_xarray(ensemble.select([0, 1, 2]))


def test_every_model_has_the_shapes_of_its_ensemble():
    class Fewer(Level):
        def fit(self, ensemble):
            return super().fit(ensemble.select([0, 1]))

    ensemble = attrs.evolve(ensemble_of(), channels={"emg": ensemble_of().torque})
    with pytest.raises(tv.InputError, match=r"must be of shape \(20, 200\), it is \(2, 200\)"):
        Fewer().identify(ensemble)


def test_what_a_model_says_is_nobodys_to_change():
    values, levels = np.ones(3), np.arange(3.0)
    estimate = tv.Estimate(values, "N m/rad", ("emg",), tv.StandardError(values, values))

    class Over(tv.Method):
        def fit(self, ensemble):
            return model_of(ensemble, {"stiffness": estimate}, emg=levels)

    model = Over().identify(ensemble_of())
    values[0] = levels[0] = 99.0
    for held in (
        estimate.values,
        estimate.error.values,
        estimate.error.freedom,
        model.coordinates["emg"],
    ):
        assert held[0] < 2
        with pytest.raises(ValueError, match="read-only"):
            held[0] = 5.0
    rank = np.ones(3)
    Diagnostics(1.0, rank)
    rank[0] = 2.0
    with pytest.raises(
        tv.InputError, match=r"expected a tuple of axes, got 'emg'; write \('emg',\)"
    ):
        tv.Estimate(np.ones(3), "N m/rad", "emg")


def by_hand(raw, method, folds):
    """Held-out VAF of whole realizations, by subtracting the means of those kept."""
    out = np.full(len(raw), np.nan)
    for part in np.array_split(np.arange(len(raw)), folds):
        kept = np.setdiff1d(np.arange(len(raw)), part)
        model = method.identify(tv.preprocess.subtract_mean(raw.select(kept)))
        left = attrs.evolve(
            raw.select(part),
            angle=raw.angle[part] - raw.angle[kept].mean(axis=0),
            torque=raw.torque[part] - raw.torque[kept].mean(axis=0),
        )
        out[part] = tv.metrics.vaf(left.torque[:, left.core], model.predict(left))
    return out


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:eirf. 45 realizations are less than twice the 25 lags")
def test_vaf_of_realizations_held_out_is_that_of_the_raw_data_less_means_of_the_others():
    raw = ensemble_of(120.0)
    raw = attrs.evolve(
        raw, torque=raw.torque + np.sin(np.arange(raw.torque.shape[1]) / 20), angle=raw.angle + 1
    )
    found = tv.compare(tv.preprocess.subtract_mean(raw), ["sds", "eirf", "birf"])
    calls = []
    held_out = found.held_out_vaf(4, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(number, 12) for number in range(12)]
    for label, method in found.methods.items():
        np.testing.assert_allclose(held_out[label], by_hand(raw, method, 4), atol=1e-8)
    # In sample, the method with the most parameters is the best; of other realizations it predicts
    # the least.
    assert found.vaf["eirf"].mean() > found.vaf["sds"].mean() + 2
    assert held_out["eirf"].mean() < held_out["sds"].mean() - 3


class Watched(tv.Method):
    """Keeps the ensembles that it identifies from and predicts for."""

    def __init__(self):
        self.seen = []

    def fit(self, kept):
        def predict(every):
            self.seen.append((kept, every))
            return {"intrinsic": np.zeros((len(every), every.samples))}

        return tv.Model.of(kept, 100.0, pathways=predict)


def test_nothing_of_what_is_held_out_is_seen():
    method = Watched()
    found = tv.compare(tv.preprocess.subtract_mean(ensemble_of(80.0)), [method])
    assert not found.held_out_vaf()["Watched"].any()
    parts = np.array_split(np.arange(40), 5)
    for (kept, every), part in zip(method.seen[1:], parts, strict=True):
        np.testing.assert_array_equal(kept.onsets, np.delete(found.ensemble.onsets, part))
        np.testing.assert_allclose(
            [kept.angle.mean(axis=0), kept.torque.mean(axis=0)], 0, atol=1e-13
        )
        assert not every.torque[part].any()
        assert len(every) == 40


@pytest.mark.slow
def test_held_out_vaf_says_where_a_method_cannot_do_without_a_fold():
    ensemble = tv.preprocess.subtract_mean(ensemble_of(20.0).select([0, 1, 2, 3]))
    with pytest.warns(tv.DataQualityWarning, match="leave open whether there is a stretch reflex"):
        found = tv.compare(ensemble, ["adaptive", "kbr"])
    with pytest.warns(
        tv.DataQualityWarning,
        match="adaptive: no held-out VAF .*: it needs at least 4 realizations",
    ):
        held_out = found.held_out_vaf()
    assert np.isnan(held_out["adaptive"]).all()
    assert np.isfinite(held_out["kbr"]).all()
    with pytest.raises(tv.InputError, match="folds must be a whole number from 2 on, got 1"):
        found.held_out_vaf(1)
    alone, two = (attrs.evolve(found, ensemble=ensemble.select(range(count))) for count in (1, 2))
    assert np.isnan(alone.held_out_vaf()["kbr"]).all()
    assert np.isnan(two.held_out_vaf()["kbr"]).all()
