"""Provide the functions and names that several methods share."""

from tvsysid.methods.shared.correlations import solve_windows
from tvsysid.methods.shared.estimates import Errors, impedance_estimates, standard_errors
from tvsysid.methods.shared.instrument import MIN_SHARE, ByReference
from tvsysid.methods.shared.residuals import (
    Colour,
    colour_products,
    independent_realizations,
    independent_share,
    posterior_errors,
    residual,
    residual_agreement,
    second_order_residual,
    second_order_torque,
)
from tvsysid.methods.shared.segments import (
    InstrumentalFit,
    SegmentFit,
    instrumental_fit,
    segment_colour,
)
from tvsysid.methods.shared.windows import impulse_response_model, window_model
from tvsysid.models import IMPEDANCE, StandardError
from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.numerics.gaussian import PRIORS, Moments, Regression
from tvsysid.numerics.instrument import HARDLY_MOVED
from tvsysid.numerics.moments import convolve_lags, lagged_moments
from tvsysid.numerics.noise import autocovariance
from tvsysid.numerics.second_order import (
    derivative_filters,
    derivative_moments,
    second_order_fit,
)
from tvsysid.numerics.spectra import hann, short_time_spectra
