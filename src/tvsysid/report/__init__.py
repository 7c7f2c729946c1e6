"""A study, or a diagnosis, as one page: what was done, what came out, and how to do it again."""

from tvsysid.report.diagnosis import diagnosis_section, write_diagnosis
from tvsysid.report.page import write_report
from tvsysid.report.tables import troubles

__all__ = ["diagnosis_section", "troubles", "write_diagnosis", "write_report"]
