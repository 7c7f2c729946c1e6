"""Figures: each function takes what it draws and returns a figure; none computes more than means and spreads.

A ``title`` stands above all of a figure.
"""

from tvsysid.figures.adaptive import adaptive_impedance
from tvsysid.figures.comparison import BARS_OF_PATHWAYS, method_comparison
from tvsysid.figures.diagnosis import diagnosis_illustration, diagnosis_panels
from tvsysid.figures.identification import identified_impedance, identified_quantity, tuning_curves
from tvsysid.figures.leaderboard import leaderboard
from tvsysid.figures.objects import plot
from tvsysid.figures.participants import participant_in_detail, stiffness_of_participants, stiffness_with_bands
from tvsysid.figures.planning import planned_recording
from tvsysid.figures.preparation import preparation_steps
from tvsysid.figures.recorded import ensemble_signals, recorded_channels, recorded_signals
from tvsysid.figures.saving import Illustration, Picture, draw_all, drawn, helpers, save, share_out
from tvsysid.figures.scheduling import scheduled_estimates, variable_of
from tvsysid.figures.simulations import coverage_over_time, error_against, error_against_amount, impulse_responses
from tvsysid.figures.spread import error_against_truth, variance_and_spread
from tvsysid.figures.style import lines
from tvsysid.figures.visits import Visit, stiffness_of_visits

__all__ = [
    "BARS_OF_PATHWAYS",
    "Illustration",
    "Picture",
    "adaptive_impedance",
    "coverage_over_time",
    "diagnosis_illustration",
    "diagnosis_panels",
    "draw_all",
    "error_against",
]
__all__ += [
    "drawn",
    "ensemble_signals",
    "error_against_amount",
    "error_against_truth",
    "helpers",
    "identified_impedance",
    "identified_quantity",
]
__all__ += [
    "impulse_responses",
    "leaderboard",
    "lines",
    "method_comparison",
    "participant_in_detail",
    "planned_recording",
    "plot",
]
__all__ += [
    "preparation_steps",
    "recorded_channels",
    "recorded_signals",
    "save",
    "scheduled_estimates",
    "share_out",
    "stiffness_of_participants",
]
__all__ += [
    "Visit",
    "stiffness_of_visits",
    "stiffness_with_bands",
    "tuning_curves",
    "variable_of",
    "variance_and_spread",
]
