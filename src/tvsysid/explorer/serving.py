"""The page at an address of this computer alone, for a command and for notebooks."""

from __future__ import annotations

import secrets
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import parse_qsl

from tvsysid.errors import InputError
from tvsysid.explorer.outcome import ONE_AT_A_TIME, forget
from tvsysid.explorer.page import page, result
from tvsysid.explorer.settings import Settings
from tvsysid.preprocess.trials import nearest_rate
from tvsysid.recordings import Channel, Reading, describe_file
from tvsysid.recordings.reading import split_settings
from tvsysid.signals import Recording

HOST = "127.0.0.1"
USUAL_RATE_HZ = 100.0


class Exploration:
    """A page that is open; a notebook shows it.

    ``url`` is its address on this computer, ``close`` ends it.
    """

    def __init__(self, start: Settings, channels: dict[str, Channel], port: int = 0) -> None:
        # The address is secret: other users and other pages cannot open this page.
        path = f"/{secrets.token_urlsafe(12)}/"
        content = page(start, channels)
        newest: list[object] = []

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.reply(content)

            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"])).decode()
                form = dict(parse_qsl(body, keep_blank_values=True))
                newest[:] = [self]
                with ONE_AT_A_TIME:
                    is_replaced = self not in newest  # by a later choice
                    self.reply("" if is_replaced or self.path != path else result(form, start))

            def reply(self, text: str) -> None:
                is_known = self.path == path
                with suppress(ConnectionError):  # the page has gone on
                    self.send_response(200 if is_known else 404)
                    self.send_header("Content-Type", "text/html; charset=utf-8")
                    self.end_headers()
                    self.wfile.write(text.encode() if is_known else b"")

            def log_message(self, *given: object) -> None:
                pass

        try:
            self._server = ThreadingHTTPServer((HOST, port), Handler)
        except (OSError, OverflowError) as error:
            raise InputError(f"port {port}: {error}; give another, or none for any free") from error
        self.url = f"http://{HOST}:{self._server.server_port}{path}"
        self._thread = Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def wait(self) -> None:
        """Wait until it is closed, or the program is interrupted."""
        self._thread.join()

    def close(self) -> None:
        """Close the page and release the recording. A running identification is abandoned."""
        self._server.shutdown()
        self._server.socket.close()
        forget()

    def __repr__(self) -> str:
        return f"Exploration({self.url})"

    def _repr_html_(self) -> str:
        return (
            f'<iframe src="{self.url}" title="tvsysid explore" width="100%" height="900" '
            'style="border:0"></iframe>'
        )


def explore(
    source: str | Path | Recording,
    *,
    method: str = "adaptive",
    port: int = 0,
    **settings: Any,
) -> Exploration:
    """Open a page on which settings are chosen and their result is seen at once.

    A notebook shows the page below the cell.

    Parameters
    ----------
    source
        File, or a recording that has been read.
    method
        Method to begin with.
    port
        Port of the page on this computer; 0 for any that is free.
    **settings
        What the page begins with, as of :class:`tvsysid.recordings.Reading` (``angle``, ``torque``,
        ``sampling_rate``, ...) and :class:`tvsysid.recordings.Segmentation` (``period``,
        ``decimate``, ``context``; decimation to some 100 Hz unless given).

    Raises
    ------
    InputError
        If the file cannot be read, a setting is not valid, or the port is in use.

    Examples
    --------
    >>> import tvsysid as tv
    >>> tv.explore("ankle.mat", angle="angle", torque="torque", period=2.0)  # doctest: +SKIP
    Exploration(http://127.0.0.1:45219/v2VwJqQ6dRkB1mfX/)
    """
    rate = settings.get("sampling_rate")
    if isinstance(source, Recording):
        rate = source.sampling_rate
    usual = USUAL_RATE_HZ if rate is None else nearest_rate(rate, USUAL_RATE_HZ)
    reading, cutting = split_settings({"decimate": usual} | settings)
    channels: dict[str, Channel] = {}
    if isinstance(source, str | Path):
        source = Path(source)
        channels = {
            name: each
            for name, each in describe_file(source).items()
            if each.values is not None and 1 <= len(each.shape) <= 2 and max(each.shape) > 1
        }
    elif reading != Reading():
        raise InputError("explore: a recording has been read; leave out the settings for reading")
    start = Settings(source, reading, cutting, method=method)
    return Exploration(start, channels, port)
