"""Pictures: each function takes results and returns a figure; none computes more than means and spreads."""

from tvsysid.figures.amount import error_against_amount
from tvsysid.figures.channels import recorded_channels
from tvsysid.figures.comparison import method_comparison
from tvsysid.figures.diagnosis import diagnosis_illustration, diagnosis_panels
from tvsysid.figures.identification import identified_stiffness
from tvsysid.figures.preparation import preparation_steps
from tvsysid.figures.responses import impulse_responses
from tvsysid.figures.study import Illustration, study_figures
from tvsysid.figures.style import drawn, lines, save

__all__ = [
    "Illustration",
    "diagnosis_illustration",
    "diagnosis_panels",
    "drawn",
    "error_against_amount",
    "identified_stiffness",
    "impulse_responses",
    "lines",
    "method_comparison",
    "preparation_steps",
    "recorded_channels",
    "save",
    "study_figures",
]
