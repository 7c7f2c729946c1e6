import dataclasses

import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv


@dataclasses.dataclass(frozen=True)
class Mean:
    """The mean torque at each time: its standard error over realizations is known."""

    def identify(self, ensemble):
        torque = ensemble.torque[:, ensemble.core]

        class Found:
            stiffness = torque.mean(axis=0)

            def predict(self, other):
                return np.zeros((len(other), other.samples))

        return Found()


def test_the_standard_error_of_a_mean():
    ensemble = ensemble_of()
    found = tv.uncertainty.bootstrap(Mean(), ensemble, 400, seed=3)
    torque = ensemble.torque[:, ensemble.core]
    expected = torque.std(axis=0) / np.sqrt(len(ensemble))
    deviation = found.stiffness.std(axis=0, ddof=1)
    assert np.sqrt(np.mean(deviation**2) / np.mean(expected**2)) == pytest.approx(1.0, abs=0.03)
    lower, upper = found.stiffness_band(0.95)
    np.testing.assert_allclose((lower + upper) / 2, found.model.stiffness, atol=1e-12)
    # Student's t with 19 degrees of freedom, and the variance of a mean, which divides by 19.
    np.testing.assert_allclose(upper - lower, 2 * 2.0930241 * np.sqrt(20 / 19) * deviation, rtol=1e-6)
    assert np.isnan(found.viscosity).all()
    assert np.isnan(found.inertia_band()).all()


def test_draws_repeat_and_only_grow():
    ensemble, method = ensemble_of(), tv.BasisIRF()
    told = []
    few = tv.uncertainty.bootstrap(method, ensemble, 3, seed=1, progress=lambda *done: told.append(done))
    more = tv.uncertainty.bootstrap(method, ensemble, 5, seed=1)
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert len(few) == 3
    for name in ("stiffness", "viscosity", "inertia"):
        np.testing.assert_array_equal(getattr(few, name), getattr(more, name)[:3])
    with pytest.raises(ValueError, match="read-only"):
        few.stiffness[0] = 0.0
    assert "3 draws of BasisIRF" in repr(few)
    narrow, wide = few.stiffness_band(0.5), few.stiffness_band(0.95)
    assert (narrow[1] - narrow[0] < wide[1] - wide[0]).all()


def test_it_agrees_with_the_closed_form():
    found = tv.uncertainty.bootstrap(tv.BasisIRF(), ensemble_of(150.0), 60, seed=2)
    closed = found.model.random_error.deviation
    for quantity, draws in enumerate((found.stiffness, found.viscosity)):
        ratio = np.sqrt(np.mean(draws.var(axis=0, ddof=1)) / np.mean(closed[quantity] ** 2))
        assert ratio == pytest.approx(1.0, abs=0.25)


def test_single_draws_do_not_warn():
    with pytest.warns(tv.DoubtfulWarning, match="fewer than the 25 lags") as caught:
        tv.uncertainty.bootstrap(tv.EnsembleIRF(), ensemble_of(40.0), 3, seed=1)
    assert len(caught) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((None, ensemble_of(), 5, 1), r"expected a method with identify\(ensemble\), got an object of NoneType"),
        ((Mean(), np.zeros((3, 4)), 5, 1), "expected an Ensemble, got ndarray"),
        ((Mean(), ensemble_of().select([0]), 5, 1), "at least 2 realizations to draw from, got 1"),
        ((Mean(), ensemble_of(), 1, 1), "at least 2 draws, got 1"),
        ((Mean(), ensemble_of(), 2.5, 1), "count must be a whole number"),
        ((Mean(), ensemble_of(), 5, "x"), "seed must be"),
    ],
)
def test_what_cannot_be_drawn_is_refused(arguments, message):
    with pytest.raises(tv.InputError, match=message):
        tv.uncertainty.bootstrap(*arguments)
