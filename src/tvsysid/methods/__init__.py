"""The methods: one file each, behind one verb, ``identify(ensemble) -> model``; and plugins."""

from tvsysid.methods.adaptive.adaptive import AdaptiveRegression
from tvsysid.methods.apply import Identifies, apply, deviating_channels
from tvsysid.methods.base import Choice, Input, Method, reason_to_skip
from tvsysid.methods.basis_cascade import BasisCascade
from tvsysid.methods.birf import BasisIRF
from tvsysid.methods.cascade.cascade import JointCascade
from tvsysid.methods.description import describe
from tvsysid.methods.eirf import EnsembleIRF
from tvsysid.methods.ensemble_cascade import EnsembleCascade
from tvsysid.methods.esm import EnsembleSpectral
from tvsysid.methods.kbr.kbr import KernelRegression
from tvsysid.methods.modal import ModalDecomposition
from tvsysid.methods.parallel_cascade import ParallelCascade
from tvsysid.methods.plugins import (
    CLOSED_LOOP,
    DEFAULT_METHODS,
    METHODS,
    PAPER_METHODS,
    STUDIED_METHODS,
    clashes,
    create,
    found_as,
    from_text,
    key_of,
    label_of,
    load,
    names,
    parse,
    typed,
)
from tvsysid.methods.scheduled.methods import ScheduledImpedance, ScheduledIRF
from tvsysid.methods.sds import ShortDataSegments
from tvsysid.methods.skirt import SkirtDecomposition
from tvsysid.methods.subspace_cascade import SubspaceCascade
from tvsysid.methods.tuning.evidence import Evidence, Tuned

__all__ = [
    "CLOSED_LOOP",
    "DEFAULT_METHODS",
    "METHODS",
    "PAPER_METHODS",
    "STUDIED_METHODS",
    "AdaptiveRegression",
    "BasisCascade",
    "BasisIRF",
    "Choice",
    "EnsembleCascade",
    "EnsembleIRF",
    "EnsembleSpectral",
    "Evidence",
]
__all__ += ["Identifies", "Input"]
__all__ += [
    "JointCascade",
    "KernelRegression",
    "Method",
    "ModalDecomposition",
    "ParallelCascade",
    "ShortDataSegments",
    "Tuned",
    "apply",
    "clashes",
    "create",
    "describe",
]
__all__ += [
    "deviating_channels",
    "found_as",
    "from_text",
    "key_of",
    "label_of",
    "load",
    "names",
    "parse",
]
__all__ += [
    "ScheduledIRF",
    "ScheduledImpedance",
    "SkirtDecomposition",
    "SubspaceCascade",
    "reason_to_skip",
    "typed",
]
