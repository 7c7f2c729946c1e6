"""A study or an experiment as one page: what was run, what came out, and how to do it again."""

from tvsysid.report.experiment import write_experiment_report
from tvsysid.report.experiment_tables import experiment_troubles
from tvsysid.report.page import write_report
from tvsysid.report.tables import troubles

__all__ = ["experiment_troubles", "troubles", "write_experiment_report", "write_report"]
