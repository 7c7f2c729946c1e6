"""A study as one page: what was run, what came out, and how to do it again."""

from tvsysid.report.page import write_report
from tvsysid.report.tables import troubles

__all__ = ["troubles", "write_report"]
