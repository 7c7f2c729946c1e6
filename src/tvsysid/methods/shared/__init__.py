"""What several methods share, and the vocabulary in which they are written."""

from tvsysid.estimates import IMPEDANCE, StandardError, impedance_estimates, no_errors, standard_errors
from tvsysid.impedance import DerivativeMoments, agreement, derivative_filters, derivative_moments, second_order_fit
from tvsysid.methods.shared.correlations import (
    Solver,
    Windows,
    coloured_variances,
    errors_of_variances,
    impulse_response_model,
    solve_windows,
    window_errors,
    window_model,
)
from tvsysid.methods.shared.residuals import (
    LONGEST_COLOUR,
    Colour,
    PosteriorErrors,
    agreement_of,
    counted,
    independent_realizations,
    independent_share,
    residual,
)
from tvsysid.numerics.bayes import PRIORS, Posterior
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.moments import convolve_lags, lagged_moments, time_chunks
from tvsysid.numerics.spectra import hann, power_share, short_time_spectra

__all__ = [
    "HALF_WIDTH",
    "IMPEDANCE",
    "LONGEST_COLOUR",
    "PRIORS",
    "Colour",
    "DerivativeMoments",
    "Posterior",
    "PosteriorErrors",
    "Solver",
    "StandardError",
    "Windows",
    "agreement",
    "agreement_of",
    "coloured_variances",
    "convolve_lags",
    "counted",
    "derivative_filters",
    "derivative_moments",
    "differentiate",
    "errors_of_variances",
    "hann",
    "impedance_estimates",
    "impulse_response_model",
    "independent_realizations",
    "independent_share",
    "lagged_moments",
    "no_errors",
    "power_share",
    "residual",
    "second_order_fit",
    "short_time_spectra",
    "solve_windows",
    "standard_errors",
    "time_chunks",
    "window_errors",
    "window_model",
]
