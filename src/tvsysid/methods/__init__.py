"""The methods: one file each, behind one verb, ``identify(ensemble) -> model``; and plugins."""

from tvsysid.methods.base import Method
from tvsysid.methods.birf import BasisIRF
from tvsysid.methods.eirf import EnsembleIRF
from tvsysid.methods.esm import EnsembleSpectral
from tvsysid.methods.foreign import adopted
from tvsysid.methods.kbr.kbr import KernelRegression
from tvsysid.methods.plugins import (
    METHODS,
    Identifies,
    clashes,
    create,
    describe,
    from_text,
    key_of,
    label_of,
    load,
    names,
    parse,
    typed,
)
from tvsysid.methods.sds import ShortDataSegments
from tvsysid.methods.tuning.evidence import Evidence
from tvsysid.methods.tuning.tuning import Tuned

__all__ = [
    "METHODS",
    "BasisIRF",
    "EnsembleIRF",
    "EnsembleSpectral",
    "Evidence",
    "Identifies",
    "KernelRegression",
    "Method",
    "ShortDataSegments",
    "Tuned",
    "adopted",
    "clashes",
    "create",
    "describe",
    "from_text",
    "key_of",
    "label_of",
    "load",
    "names",
    "parse",
    "typed",
]
