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
from tvsysid.explorer.settings import Settings
from tvsysid.preprocess.trials import nearest_rate
from tvsysid.recordings import Reading, Segmentation, describe_file
from tvsysid.signals import Recording

if TYPE_CHECKING:
    from shiny import App

HOST = "127.0.0.1"
USUAL_RATE_HZ = 100.0
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


def explore(
    source: str | Path | Recording,
    *,
    method: str = "adaptive",
    align_channels: bool = True,
    port: int = 0,
    **settings: Any,
) -> Exploration:
    """Open a page on which settings are chosen and their result is seen at once.

    Needs Shiny: ``pip install 'tvsysid[explore]'``. A notebook shows the page below the cell.

    Parameters
    ----------
    source
        File, or a recording that has been read.
    method, align_channels
        Method to begin with, and whether to correct a delay of the torque.
    port
        Port of the page on this computer; 0 for any that is free.
    **settings
        What the page begins with, as of :class:`tvsysid.recordings.Reading` (``angle``, ``torque``,
        ``sampling_rate``, ...) and :class:`tvsysid.recordings.Segmentation` (``period``,
        ``decimate``, ``context``; decimation to some 100 Hz unless given).

    Raises
    ------
    InputError
        If Shiny is not installed, the file cannot be read, a setting is not valid, or the port is
        in use.

    Examples
    --------
    >>> import tvsysid as tv
    >>> tv.explore("ankle.mat", angle="pos", torque="tq", period=2.0)  # doctest: +SKIP
    Exploration(http://127.0.0.1:45219/v2VwJqQ6dRkB1mfX/)
    """
    try:
        from tvsysid.explorer.page import page  # noqa: PLC0415  # optional
    except ModuleNotFoundError as error:
        raise InputError("the explorer needs Shiny: pip install 'tvsysid[explore]'") from error
    own = {name: settings.pop(name) for name in attrs.fields_dict(Reading) if name in settings}
    reading = Reading(**own)
    rate = source.sampling_rate if isinstance(source, Recording) else reading.sampling_rate
    usual = USUAL_RATE_HZ if rate is None else nearest_rate(rate, USUAL_RATE_HZ)
    cutting = Segmentation(**{"decimate": usual} | settings)
    channels: dict[str, str] = {}
    if isinstance(source, str | Path):
        source = Path(source)
        channels = {
            name: f"{name} ({each.described})"
            for name, each in describe_file(source).items()
            if each.values is not None and 1 <= len(each.shape) <= 2 and max(each.shape) > 1
        }
        chosen = filter(None, (reading.angle, reading.torque, *reading.channels.values()))
        if unknown := [name for name in chosen if name not in channels]:
            raise InputError(f"no channel {unknown[0]!r}; the file holds {', '.join(channels)}")
    elif own:
        raise InputError(f"explore: a recording has been read already; leave out {min(own)}")
    start = Settings(source, reading, cutting, align_channels, method)
    return Exploration(page(start, channels), port)
