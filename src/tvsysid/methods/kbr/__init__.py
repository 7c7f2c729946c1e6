"""Kernel-based regression: the method and its model are in kbr.py; here is what they are made of."""

from tvsysid.methods.kbr.fitting import Fitted, fitted
from tvsysid.methods.kbr.kernel import ENDLESS, Kernel
from tvsysid.methods.kbr.likelihood import Tried
from tvsysid.methods.kbr.record import Record, lagged
from tvsysid.methods.kbr.search import HIGHEST, Search
from tvsysid.methods.tuning.evidence import Evidence
from tvsysid.numerics.gaussian import Fit, fit
