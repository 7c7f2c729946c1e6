"""A study, an experiment or a diagnosis as one page: what was done, what came out, and how to do it again."""

from tvsysid.report.diagnosis import diagnosis_section, write_diagnosis
from tvsysid.report.experiment import write_experiment_report
from tvsysid.report.sections import problems
from tvsysid.report.study import CLAIMS, write_report

__all__ = ["CLAIMS", "diagnosis_section", "problems", "write_diagnosis", "write_experiment_report", "write_report"]
