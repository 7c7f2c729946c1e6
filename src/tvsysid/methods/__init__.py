"""The methods, one file or folder each: classes with settings and ``fit(ensemble) -> Model``."""

from tvsysid.methods.adaptive.adaptive import AdaptiveRegression
from tvsysid.methods.base import Choice, Input, Method, centered_channels, reason_to_skip
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
from tvsysid.methods.registry import (
    CLOSED_LOOP,
    DEFAULT_METHODS,
    METHODS,
    PAPER_METHODS,
    STUDIED_METHODS,
    expand,
    from_text,
    key_of,
    label_of,
    load,
    names,
    parse,
    resolve,
    to_text,
)
from tvsysid.methods.scheduled.scheduled import ScheduledImpedance, ScheduledIRF
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
    "Input",
    "JointCascade",
    "KernelRegression",
    "Method",
    "ModalDecomposition",
    "ParallelCascade",
    "ScheduledIRF",
    "ScheduledImpedance",
    "ShortDataSegments",
    "SkirtDecomposition",
    "SubspaceCascade",
    "Tuned",
    "centered_channels",
    "describe",
    "expand",
    "from_text",
    "key_of",
    "label_of",
    "load",
    "names",
    "parse",
    "reason_to_skip",
    "resolve",
    "to_text",
]
