"""Progress of long work: a function of the number of finished steps and their total."""

from collections.abc import Callable

Progress = Callable[[int, int], object]


def no_progress(done: int, total: int) -> None:
    """Ignore the progress."""
