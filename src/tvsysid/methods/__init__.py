"""The methods, one file or folder each: classes with settings and ``fit(ensemble) -> Model``."""

from tvsysid.methods.base import Choice, Input, Method, centered_channels, reason_to_skip
from tvsysid.methods.description import describe
from tvsysid.methods.registry import (
    CLOSED_LOOP,
    METHODS,
    PAPER_METHODS,
    STUDIED_METHODS,
    AdaptiveRegression,
    BasisCascade,
    BasisIRF,
    EnsembleCascade,
    EnsembleIRF,
    EnsembleSpectral,
    JointCascade,
    KernelRegression,
    ModalDecomposition,
    ParallelCascade,
    ScheduledImpedance,
    ScheduledIRF,
    ShortDataSegments,
    SkirtDecomposition,
    SubspaceCascade,
    expand,
    from_text,
    key_of,
    label_of,
    load,
    parse,
    resolve,
    to_text,
)
from tvsysid.methods.tuning import Evidence, Tuned
