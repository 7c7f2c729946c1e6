"""Identify one ensemble by several methods, and compare what they find and predict."""

from tvsysid.comparison.comparison import Comparison
from tvsysid.comparison.identify import compare
from tvsysid.comparison.preparation import PreparedRecording, correct, prepare

__all__ = ["Comparison", "PreparedRecording", "compare", "correct", "prepare"]
