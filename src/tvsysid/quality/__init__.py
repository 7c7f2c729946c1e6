"""Check data for faults: a catalogue of faults with one limit each, and a diagnosis."""

from tvsysid.quality.checks import FAULTS, Finding
from tvsysid.quality.curves import Curves
from tvsysid.quality.diagnosis import Diagnosis, diagnose, diagnose_recording

__all__ = [
    "FAULTS",
    "Curves",
    "Diagnosis",
    "Finding",
    "diagnose",
    "diagnose_recording",
]
