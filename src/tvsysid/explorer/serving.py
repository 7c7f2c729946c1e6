"""The page at an address of this computer alone, for a command and for notebooks."""

from __future__ import annotations

import html
import secrets
import socket
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs

from tvsysid.errors import InputError
from tvsysid.explorer.settings import Cutting, checked
from tvsysid.recordings import Reading, describe_file
from tvsysid.recordings.reading import OPTION_NAMES
from tvsysid.signals import Recording

if TYPE_CHECKING:
    from shiny import App

HOST = "127.0.0.1"
OF_A_FILE = {OPTION_NAMES.get(item.name, item.name) for item in attrs.fields(Reading)}
FIRST: dict[str, Any] = {
    OPTION_NAMES.get(name, name): value
    for settings in (Reading(), Cutting())
    for name, value in attrs.asdict(settings).items()
} | {"channel": (), "decimate": 100.0, "method": "adaptive"}
"""What the page begins with: what `tvsysid identify` does by itself, and a rate that is quick."""
GRACE_S = 1  # for pages that are still open when it closes


class Exploration:
    """A page that is open; a notebook shows it.

    ``url`` is its address on this computer, ``close`` ends it.
    """

    def __init__(self, app: App, port: int = 0) -> None:
        import uvicorn  # noqa: PLC0415  # optional
        from starlette.applications import Starlette  # noqa: PLC0415
        from starlette.routing import Mount  # noqa: PLC0415

        listening = socket.socket()
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((HOST, port))
        except (OSError, OverflowError, TypeError) as error:
            listening.close()
            reason = getattr(error, "strerror", None) or "expected a whole number from 0 to 65535"
            raise InputError(
                f"port {port}: {reason}; give another, or none for any that is free"
            ) from error
        # Nobody else on this computer, and no other page of the browser, knows the address.
        secret = secrets.token_urlsafe(12)
        self.url = f"http://{HOST}:{listening.getsockname()[1]}/{secret}/"
        behind = Starlette(routes=[Mount(f"/{secret}", app=app)])
        config = uvicorn.Config(behind, log_level="error", timeout_graceful_shutdown=GRACE_S)
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([listening],), daemon=True)
        self._thread.start()
        while not self._server.started and self._thread.is_alive():
            time.sleep(0.01)

    def wait(self) -> None:
        """Wait until it is closed, or the program is interrupted."""
        self._thread.join()

    def close(self) -> None:
        """Close the page and release the recording. A running identification is abandoned."""
        from tvsysid.explorer.outcome import forget  # noqa: PLC0415  # heavy

        self._server.should_exit = True
        self._thread.join(GRACE_S + 2)
        forget()

    def __repr__(self) -> str:
        return f"Exploration({self.url})"

    def _repr_html_(self) -> str:
        source = html.escape(self.url)
        return (
            f'<iframe src="{source}" title="tvsysid explore" width="100%" height="900" '
            f'style="border:0"></iframe>'
        )


def explore(source: str | Path | Recording, *, port: int = 0, **given: Any) -> Exploration:
    """Open a page on which settings are chosen and their result is seen at once.

    What ``tvsysid explore`` does.

    Needs Shiny: ``pip install 'tvsysid[explore]'``. A notebook shows the page below the cell.

    Parameters
    ----------
    source
        File, or a recording that has been read.
    port
        Where the page is, on this computer alone; 0 for any port that is free.
    **given
        What the page begins with: the options of ``tvsysid explore``, by the same names (``angle``,
        ``torque``, ``rate``, ``period``, ``decimate``, ``method``, ``align_channels``, ...). What
        is not given is chosen there.

    Raises
    ------
    InputError
        If Shiny is not installed, the file cannot be read, an option is unknown or none that the
        page can show, or the port is in use.

    Examples
    --------
    >>> import tvsysid as tv
    >>> tv.explore("ankle.mat", angle="pos", torque="tq", rate=1000, period=2.0)  # doctest: +SKIP
    Exploration(http://127.0.0.1:45219/v2VwJqQ6dRkB1mfX/)
    """
    try:
        from tvsysid.explorer.page import page  # noqa: PLC0415  # optional
    except ModuleNotFoundError as error:
        raise InputError("the explorer needs Shiny: pip install 'tvsysid[explore]'") from error
    if not isinstance(source, str | Path | Recording):
        raise InputError(f"explore: expected a file or a Recording, got {type(source).__name__}")
    options = [name for name in FIRST if name not in OF_A_FILE or not isinstance(source, Recording)]
    if unknown := given.keys() - set(options):
        raise InputError(
            f"explore: unknown option {min(unknown)!r}; the options are {', '.join(options)}"
        )
    given = FIRST | given
    if isinstance(source, Recording):
        return Exploration(page("recording", source, checked(given), {}), port)
    file = Path(source)
    signals = {
        name: f"{name} ({each.described})"
        for name, each in describe_file(file).items()
        if each.values is not None and 1 <= len(each.shape) <= 2 and max(each.shape) > 1
    }
    given = checked(given, signals)
    fixed = {
        "file": file,
        "start": given["start"],
        "channel": given["channel"],
    }
    return Exploration(page(file.name, fixed, given, signals), port)
