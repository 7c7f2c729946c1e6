"""Pictures: each function takes results and returns a figure or axes; none computes."""

from tvsysid.figures.comparison import method_comparison
from tvsysid.figures.identification import identified_stiffness
from tvsysid.figures.style import lines, save

__all__ = ["identified_stiffness", "lines", "method_comparison", "save"]
