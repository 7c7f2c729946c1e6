"""Bootstrap of any method, and its bands."""

import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.uncertainty import bootstrap


class Mean(tv.Method):
    """The mean torque at each time: its standard error over realizations is known."""

    def fit(self, ensemble):
        return tv.Model.of(ensemble, ensemble.torque[:, ensemble.core].mean(axis=0))


def test_the_standard_error_of_a_mean():
    ensemble = ensemble_of()
    found = bootstrap(Mean(), ensemble, 400, seed=3)
    torque = ensemble.torque[:, ensemble.core]
    expected = torque.std(axis=0) / np.sqrt(len(ensemble))
    draws = tv.preprocess.bootstrap_weights(20, 20, 400, 3) @ torque / 20
    deviation = draws.std(axis=0, ddof=1)
    assert np.sqrt(np.mean(deviation**2) / np.mean(expected**2)) == pytest.approx(1.0, abs=0.03)
    lower, upper = found.estimates["stiffness"].band(0.95)
    np.testing.assert_allclose((lower + upper) / 2, found.stiffness, atol=1e-12)
    # Student's t with 19 degrees of freedom, and the variance of a mean, which divides by 19.
    width = 2 * 2.0930241 * np.sqrt(20 / 19) * deviation
    np.testing.assert_allclose(upper - lower, width, rtol=1e-6)
    for ensemble_, count, message in (
        (
            ensemble.select([0]),
            5,
            "the number of realizations must be a whole number of 2 or more, got 1",
        ),
        (ensemble, 1, "count must be a whole number of 2 or more, got 1"),
    ):
        with pytest.raises(tv.InputError, match=message):
            bootstrap(Mean(), ensemble_, count, seed=1)
