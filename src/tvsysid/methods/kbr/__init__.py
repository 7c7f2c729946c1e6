"""Kernel-based regression: the method is in kbr.py; here is what it is made of."""

from tvsysid.methods.kbr.kernel import ENDLESS, VISIBLE, Kernel
from tvsysid.methods.kbr.likelihood import Tried
from tvsysid.methods.kbr.model import KernelModel, common_phase, mean_features, with_zeros
from tvsysid.methods.kbr.record import DEGREES, LARGEST, Record, lagged
from tvsysid.methods.kbr.search import Search
from tvsysid.methods.tuning.evidence import Evidence
from tvsysid.models import Diagnostics
from tvsysid.numerics.gaussian import Fit, fit

__all__ = ["ENDLESS", "VISIBLE", "Kernel", "KernelModel", "Tried", "common_phase", "mean_features", "with_zeros"]
__all__ += ["DEGREES", "LARGEST", "Diagnostics", "Evidence", "Fit", "Record", "Search", "fit", "lagged"]
