"""Identify one ensemble by several methods, and compare what they find and predict."""

from tvsysid.comparison.checks import with_checks
from tvsysid.comparison.comparison import Comparison
from tvsysid.comparison.identify import compare
from tvsysid.comparison.preparation import PreparedRecording, prepare_recording

__all__ = [
    "Comparison",
    "PreparedRecording",
    "compare",
    "prepare_recording",
    "with_checks",
]
