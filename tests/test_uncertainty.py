import dataclasses
import pickle
import re

import cloudpickle
import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv


@dataclasses.dataclass(frozen=True)
class Mean(tv.Method):
    """The mean torque at each time: its standard error over realizations is known."""

    def fit(self, ensemble):
        return tv.Model.of(ensemble, ensemble.torque[:, ensemble.core].mean(axis=0))


def test_the_standard_error_of_a_mean():
    ensemble = ensemble_of()
    found = tv.uncertainty.bootstrap(Mean(), ensemble, 400, seed=3)
    torque = ensemble.torque[:, ensemble.core]
    expected = torque.std(axis=0) / np.sqrt(len(ensemble))
    deviation = found.draws["stiffness"].std(axis=0, ddof=1)
    assert np.sqrt(np.mean(deviation**2) / np.mean(expected**2)) == pytest.approx(1.0, abs=0.03)
    lower, upper = found.band("stiffness", 0.95)
    np.testing.assert_allclose((lower + upper) / 2, found.model.stiffness, atol=1e-12)
    # Student's t with 19 degrees of freedom, and the variance of a mean, which divides by 19.
    np.testing.assert_allclose(
        upper - lower, 2 * 2.0930241 * np.sqrt(20 / 19) * deviation, rtol=1e-6
    )
    assert list(found.draws) == ["stiffness"]
    with pytest.raises(tv.InputError, match="there is no 'inertia'; the quantities are stiffness"):
        found.band("inertia")


def test_draws_repeat_and_only_grow():
    ensemble, method = ensemble_of(), tv.BasisIRF()
    told = []
    few = tv.uncertainty.bootstrap(
        method, ensemble, 3, seed=1, progress=lambda *done: told.append(done)
    )
    more = tv.uncertainty.bootstrap(method, ensemble, 5, seed=1)
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert few.count == 3
    assert list(few.draws) == ["stiffness", "viscosity", "inertia"]
    for name in few.draws:
        np.testing.assert_array_equal(few.draws[name], more.draws[name][:3])
    assert "3 draws of BasisIRF" in repr(few)
    narrow, wide = few.band("stiffness", 0.5), few.band("stiffness", 0.95)
    assert (narrow[1] - narrow[0] < wide[1] - wide[0]).all()


@pytest.mark.slow
def test_it_agrees_with_the_closed_form():
    # Without a prior; a sparse one counts what it prunes as known, which draws do not.
    found = tv.uncertainty.bootstrap(tv.BasisIRF(prior="none"), ensemble_of(150.0), 150, seed=2)
    for quantity, draws in found.draws.items():
        closed = found.model.estimates[quantity].standard_error.values
        ratio = np.sqrt(np.mean(draws.var(axis=0, ddof=1)) / np.mean(closed**2))
        # 75 realizations tell a standard deviation to 8 %, and inertia is one number.
        assert ratio == pytest.approx(1.0, abs=0.2 if quantity == "inertia" else 0.12)


@dataclasses.dataclass(frozen=True)
class Fragile(Mean):
    """Cannot do with some draws: those in which the first realization came this often."""

    refused: tuple[int, ...]

    def fit(self, ensemble):
        first = ensemble_of().onsets[0]
        if (ensemble.onsets == first).sum() in self.refused:
            raise np.linalg.LinAlgError("SVD did not converge")
        return super().fit(ensemble)


def test_a_bad_draw_is_left_out_and_told():
    with pytest.warns(
        tv.DataQualityWarning, match=r"of 200 draws \(the first: LinAlgError: SVD did not"
    ) as caught:
        found = tv.uncertainty.bootstrap(Fragile((2,)), ensemble_of(), 200, seed=1)
    assert caught[0].filename == __file__
    lost = np.isnan(found.draws["stiffness"]).all(axis=1)
    assert (
        found.failed == lost.sum() == pytest.approx(200 * 0.19, abs=20)
    )  # binomial: twice of 20 draws
    assert f"200 draws ({found.failed} failed) of Fragile" in repr(found)
    np.testing.assert_array_equal(
        found.draws["stiffness"][~lost],
        tv.uncertainty.bootstrap(Mean(), ensemble_of(), 200, seed=1).draws["stiffness"][~lost],
    )
    for lower, upper in (found.band(), found.band(simultaneous=True)):
        assert (lower < upper).all()
    with pytest.raises(
        tv.InputError, match=r"could not identify 200 of 200 draws .* at least 2 are needed"
    ):
        tv.uncertainty.bootstrap(OnlyTheWhole(), ensemble_of(), 200, seed=1)


class OnlyTheWhole(Mean):
    """Identifies realizations that all differ."""

    def fit(self, ensemble):
        if len(np.unique(ensemble.onsets)) < len(ensemble):
            raise ValueError("twice the same")
        return super().fit(ensemble)


@pytest.mark.slow
def test_simultaneous_band_holds_all_times_together(random):
    truth, held, held_each = np.zeros(100), [], []
    for seed in range(60):
        walk = np.cumsum(np.random.default_rng(seed).normal(size=(40, 130)), axis=1)[:, 30:]
        torque = walk / np.sqrt(np.arange(31, 131))
        ensemble = tv.Ensemble(random.normal(size=torque.shape), torque, 100.0)
        found = tv.uncertainty.bootstrap(Mean(), ensemble, 100, seed=seed)
        for share, (lower, upper) in (
            (held, found.band(simultaneous=True)),
            (held_each, found.band()),
        ):
            share.append(((lower <= truth) & (truth <= upper)).all())
    assert np.mean(held_each) < 0.85
    assert 0.88 <= np.mean(held) < 1.0


def test_single_draws_do_not_warn():
    with pytest.warns(tv.DataQualityWarning, match="fewer than the 25 lags") as caught:
        tv.uncertainty.bootstrap(tv.EnsembleIRF(), ensemble_of(40.0), 3, seed=1)
    assert len(caught) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((Mean(), ensemble_of().select([0]), 5, 1), "at least 2 realizations to draw from, got 1"),
        ((Mean(), ensemble_of(), 1, 1), "count must be a whole number from 2 on, got 1"),
        ((Mean(), ensemble_of(), 2.5, 1), "count must be a whole number"),
        ((Mean(), ensemble_of(), 5, "x"), "seed must be"),
    ],
)
def test_what_cannot_be_drawn_is_refused(arguments, message):
    with pytest.raises(tv.InputError, match=message):
        tv.uncertainty.bootstrap(*arguments)


@dataclasses.dataclass(frozen=True)
class Scheduled(tv.Method):
    """Stiffness over a measured variable, a gain over time, and an offset of each realization."""

    quantities: tuple[str, ...] = ("stiffness", "gain", "offset")
    step: float = 0.0

    def fit(self, ensemble):
        level = ensemble.torque.std()
        estimates = {
            "stiffness": tv.Estimate(np.full(3, level), "N m/rad", ("emg",)),
            "gain": tv.Estimate(np.full(ensemble.samples, level), "N m/V"),
            "offset": tv.Estimate(np.full(len(ensemble), level), "N m", ("realization",)),
        }

        return tv.Model.of(
            ensemble,
            estimates={name: estimates[name] for name in self.quantities},
            coordinates={"emg": np.arange(3) * (1 + self.step * level)},
            pathways=lambda other: {"intrinsic": np.zeros((len(other), other.samples))},
        )


def test_estimates_over_a_measured_variable_are_drawn():
    ensemble = ensemble_of()
    with pytest.warns(
        tv.DataQualityWarning, match="no band of offset: a draw has estimates at other values"
    ):
        found = tv.uncertainty.bootstrap(Scheduled(), ensemble, 5, seed=1)
    assert {name: draws.shape for name, draws in found.draws.items()} == {
        "stiffness": (5, 3),
        "gain": (5, 200),
    }
    assert "stiffness ±" in repr(found)
    for simultaneous in (False, True):
        lower, upper = found.band("stiffness", simultaneous=simultaneous)
        assert (lower < found.model.estimates["stiffness"].values).all()
        assert (upper > lower).all()
    gain = tv.uncertainty.bootstrap(Scheduled(("gain",)), ensemble, 5, seed=1)
    assert re.search("5 draws.*: gain ±.* N m/V", repr(gain))
    with pytest.warns(tv.DataQualityWarning, match="no band of stiffness"):
        moving = tv.uncertainty.bootstrap(Scheduled(("stiffness",), step=1.0), ensemble, 5, seed=1)
    assert (moving.count, moving.draws) == (5, {})
    assert "no quantity" in repr(moving)


def test_it_travels_pickled():
    found = tv.uncertainty.bootstrap(Mean(), ensemble_of(), 3, seed=1)
    for again in (
        pickle.loads(cloudpickle.dumps(found)),
        tv.uncertainty.Bootstrap(found.model, 20, {}, 0, 3),
    ):
        assert again.count == 3
