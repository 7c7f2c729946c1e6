"""Identify one ensemble by several methods, and compare what they find and predict."""

from tvsysid.comparison.comparison import Comparison, compare
from tvsysid.comparison.delay import delay_to_correct

__all__ = ["Comparison", "compare", "delay_to_correct"]
