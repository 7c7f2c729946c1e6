"""BLAS with one thread."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

# NumPy and SciPy have a BLAS each; the controller limits those that are loaded.
import scipy.linalg  # noqa: F401
from threadpoolctl import ThreadpoolController

_controller = cache(ThreadpoolController)


@contextmanager
def single_thread() -> Iterator[None]:
    """Limit BLAS to one thread.

    Threads wait for each other where matrices are small, and the last bits of a result depend on
    their number.
    """
    with _controller().limit(limits=1):
        yield
