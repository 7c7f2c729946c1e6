"""A study, an experiment, an identification or a diagnosis as one page: what was done, and what came out."""

from tvsysid.report.answer import Account
from tvsysid.report.diagnosis import diagnosis_section, write_diagnosis
from tvsysid.report.experiment import write_experiment_report
from tvsysid.report.identification import write_identification
from tvsysid.report.sections import problems
from tvsysid.report.sheet import write_sheet
from tvsysid.report.study import CLAIMS, write_report

__all__ = ["CLAIMS", "Account", "diagnosis_section", "problems", "write_diagnosis", "write_experiment_report"]
__all__ += ["write_identification", "write_report", "write_sheet"]
