"""Provide the functions and names that several methods share."""

from tvsysid.methods.shared.estimates import impedance_estimates, standard_errors
from tvsysid.methods.shared.instrument import MIN_SHARE, ReferenceMethod
from tvsysid.methods.shared.residuals import (
    colour_lags,
    independent_realizations,
    independent_share,
    noise_colour,
    noise_ratio,
    posterior_errors,
    residual,
    residual_agreement,
    second_order_residual,
    second_order_torque,
)
from tvsysid.methods.shared.windows import impulse_response_model, solve_windows, window_model
