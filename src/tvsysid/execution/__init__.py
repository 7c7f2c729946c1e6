"""How any study is carried out: tasks go to workers, what comes back to a store, and what is there is not redone."""

from tvsysid.execution.settings import settings_in
from tvsysid.execution.store import Fixed, Layout, Place, Store, Variable, open_store, read_store, title_of
from tvsysid.execution.task import (
    Outcome,
    Task,
    carry_out,
    digests,
    identified,
    pickled,
    single_thread,
    versions,
)
from tvsysid.execution.workers import carry_out_missing, cores, processes

__all__ = [
    "Fixed",
    "Layout",
    "Outcome",
    "Place",
    "Store",
    "Task",
    "Variable",
    "carry_out",
    "carry_out_missing",
    "cores",
    "digests",
    "identified",
    "open_store",
    "pickled",
    "processes",
    "read_store",
    "settings_in",
    "single_thread",
    "title_of",
    "versions",
]
