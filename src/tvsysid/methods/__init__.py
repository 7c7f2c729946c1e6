"""The methods: one file each, behind one verb, ``identify(ensemble) -> model``."""

from tvsysid.methods.base import Method
from tvsysid.methods.birf import BasisIRF
from tvsysid.methods.eirf import EnsembleIRF
from tvsysid.methods.esm import EnsembleSpectral
from tvsysid.methods.kbr import KernelRegression
from tvsysid.methods.registry import create, names, parse
from tvsysid.methods.sds import ShortDataSegments

__all__ = [
    "BasisIRF",
    "EnsembleIRF",
    "EnsembleSpectral",
    "KernelRegression",
    "Method",
    "ShortDataSegments",
    "create",
    "names",
    "parse",
]
