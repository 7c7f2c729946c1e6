"""Bands where data are few: none, with the reason, or finite ones."""

import numpy as np
import pytest
from tests.conftest import ensemble_of, standard_errors_of

import tvsysid as tv

pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


@pytest.mark.parametrize(
    ("method", "realizations", "subtracted", "message"),
    [
        (
            tv.ShortDataSegments(),
            7,
            True,
            "66 independent samples are too few for 25 lags",
        ),
        (
            tv.EnsembleIRF(0.04),
            10,
            True,
            "9 independent samples are too few for 9 lags, where 10 are needed",
        ),
        (
            tv.EnsembleSpectral(),
            1,
            False,
            "one independent realization tells nothing of the noise at 0 Hz",
        ),
    ],
)
def test_too_little_data_has_no_band_and_says_why(method, realizations, subtracted, message):
    ensemble = ensemble_of(40.0).select(np.arange(realizations))
    model = method.identify(tv.preprocess.subtract_mean(ensemble) if subtracted else ensemble)
    stiffness = model.estimates["stiffness"]
    assert np.isnan(stiffness.band()).all()
    assert message in stiffness.standard_error.absent
    assert np.isfinite(model.stiffness).all()


def test_only_windows_that_are_cut_too_short_have_no_band():
    model = tv.ShortDataSegments().identify(ensemble_of(40.0, context=0.12).select(np.arange(8)))
    known = np.isfinite(standard_errors_of(model))
    # Eight realizations of ten samples make 80; of nine they make 72, less than three times 25.
    np.testing.assert_array_equal(np.flatnonzero(~known[0]), [*range(4), *range(196, 200)])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
@pytest.mark.parametrize("realizations", [1, 10])
def test_short_realizations_have_finite_bands(perturbation, realizations, seed):
    # Of half a second, the angle's autocovariance over long lags rests on a few samples.
    ensemble = ensemble_of(60.0, "sine", perturbation, seed=seed, period=0.5).select(
        np.arange(realizations)
    )
    for method in (tv.BasisIRF(), tv.EnsembleSpectral(stiffness="fit")):
        model = method.identify(ensemble)
        for quantity, widest in (("stiffness", 2000.0), ("viscosity", 50.0), ("inertia", 1.0)):
            lower, upper = model.estimates[quantity].band()
            assert (lower <= upper).all()  # equal where the sparse prior prunes all there is
            assert np.median(upper - lower) < widest
