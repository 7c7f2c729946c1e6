"""A study, an experiment or a diagnosis as one page: what was done, what came out, and how to do it again."""

from tvsysid.report.diagnosis import diagnosis_section, write_diagnosis
from tvsysid.report.experiment import write_experiment_report
from tvsysid.report.experiment_tables import experiment_troubles
from tvsysid.report.page import write_report
from tvsysid.report.tables import troubles

__all__ = [
    "diagnosis_section",
    "experiment_troubles",
    "troubles",
    "write_diagnosis",
    "write_experiment_report",
    "write_report",
]
