"""A study as one page: what was run, what came out, and how to do it again."""

from tvsysid.report.page import write_report

__all__ = ["write_report"]
