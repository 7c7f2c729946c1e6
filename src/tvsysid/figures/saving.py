"""Draw figures once and save them in all formats, several at a time on several cores."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import attrs

from tvsysid.errors import InputError
from tvsysid.figures.style import LOOK
from tvsysid.recordings import whole_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

T = TypeVar("T")


@attrs.frozen
class Illustration:
    """A figure that is still to be drawn, and what it shows in words.

    ``draw`` gives the figure: a :func:`functools.partial` of a function of this package with what
    it draws, so that it can be sent to another process. The description, in full sentences, stands
    for the picture where it cannot be seen;
    :func:`draw_all` saves the picture with all of these endings.
    """

    draw: Callable[[], Figure]
    title: str
    description: str = ""
    endings: tuple[str, ...] = ("png", "pdf", "svg")


@attrs.frozen
class Picture:
    """Drawn figure for a page: SVG, if requested, with its size in pixels (96 per inch)."""

    title: str
    description: str
    svg: bytes
    width: int
    height: int


@contextmanager
def helpers(workers: int) -> Iterator[Executor | None]:
    """Start the processes that help :func:`share_out`, one less than ``workers``.

    They start while the caller does other things.

    A script must be guarded by ``if __name__ == "__main__":``.
    """
    from tvsysid.study import processes  # noqa: PLC0415  # heavy

    with ExitStack() as stack:
        pool = None
        with suppress(InputError):  # where none can be made, this process draws everything
            if workers > 1:
                pool = stack.enter_context(processes(workers - 1))
                for _ in range(workers - 1):
                    pool.submit(import_module, "matplotlib.backends.backend_agg")
        yield pool


def draw_all(
    illustrations: Mapping[str, Illustration],
    folder: str | Path | None = None,
    pool: Executor | None = None,
) -> dict[str, Picture]:
    """Draw figures, and save each in the forms that it has.

    Parameters
    ----------
    illustrations
        By the stem of the file's name, which may name a folder too, as in ``"participants/P1"``.
    folder
        Where the files go; each appears whole or not at all. None saves nothing.
    pool
        Of :func:`helpers`; this process draws too.
    """
    jobs = {
        stem: (each, None if folder is None else Path(folder) / stem)
        for stem, each in illustrations.items()
    }
    return share_out(_picture, jobs, pool)


def share_out(
    work: Callable[..., T], jobs: Mapping[str, tuple[object, ...]], pool: Executor | None
) -> dict[str, T]:
    """Return the results of a picklable function for several arguments by name, in order.

    Processes of :func:`helpers` begin with the first ones, this process with the last. What a
    helper that dies leaves undone is done here.
    """
    futures: dict[str, Future[T]] = {}
    if pool is not None and len(jobs) > 1:
        with suppress(BrokenExecutor):  # a helper died before
            futures = {name: pool.submit(work, *job) for name, job in jobs.items()}
    done = {
        name: work(*jobs[name])
        for name in reversed(list(jobs))
        if name not in futures or futures[name].cancel()
    }
    for name in jobs.keys() - done.keys():
        try:
            done[name] = futures[name].result()
        except BrokenExecutor:
            done[name] = work(*jobs[name])
    return {name: done[name] for name in jobs}


def _picture(illustration: Illustration, path: Path | None) -> Picture:
    """Draw one figure, and save it in all its forms if there is a path, which lacks its ending."""
    figure = illustration.draw()
    contents = {
        ending: drawn(figure, ending)
        for ending in illustration.endings
        if path is not None or ending == "svg"
    }
    if path is not None:
        for ending, content in contents.items():
            with whole_file(path.with_name(f"{path.name}.{ending}")) as temporary:
                temporary.write_bytes(content)
    width, height = (round(96 * float(inches)) for inches in figure.get_size_inches())
    return Picture(
        illustration.title, illustration.description, contents.get("svg", b""), width, height
    )


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure whole; its ending says in which format: svg, pdf or png."""
    with whole_file(path) as temporary:
        temporary.write_bytes(drawn(figure, temporary.suffix.removeprefix(".")))


def drawn(figure: Figure, format: str) -> bytes:
    """Return a figure as the content of an SVG (with text as text), PDF or PNG file.

    The same figure, the same bytes.
    """
    from matplotlib import rc_context  # noqa: PLC0415  # heavy

    # Journals refuse the Type 3 fonts that are Matplotlib's default; a file's date would make each
    # one new.
    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    forms = {"pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "tvsysid"}
    content = BytesIO()
    with rc_context(LOOK | forms), warnings.catch_warnings():
        # Chinese characters, for example. The SVG shows them
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        if (engine := figure.get_layout_engine()) is not None:
            # Laid out once for all formats. With an engine, even an idle one, Matplotlib draws
            # twice for each of them.
            engine.execute(figure)
            figure.set_layout_engine(None)
        figure.savefig(content, format=format, dpi=150, metadata=undated.get(format))
    return content.getvalue()
