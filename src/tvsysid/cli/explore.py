"""`tvsysid explore`."""

from __future__ import annotations

import os
import sys
import webbrowser
from typing import Annotated

import typer

from tvsysid.cli import options
from tvsysid.cli.console import say


def explore(
    file: options.FileArgument,
    angle: Annotated[str | None, options.ANGLE] = None,
    torque: Annotated[str | None, options.TORQUE] = None,
    rate: Annotated[float | None, options.RATE] = None,
    period: Annotated[float | None, options.PERIOD] = None,
    decimate: Annotated[
        float,
        options.option(
            "HZ", "Low-pass filter and decimate to this rate first; can be changed on the page."
        ),
    ] = 100.0,
    channel: options.ChannelOption = [],
    columns: options.ColumnsOption = "contiguous",
    torque_sign: options.TorqueSignOption = 1,
    angle_unit: options.AngleUnitOption = "rad",
    torque_unit: options.TorqueUnitOption = "Nm",
    header: options.HeaderOption = True,
    start: options.StartOption = 0.0,
    context: options.ContextOption = 0.5,
    method: Annotated[
        str, options.option("KEY[:SETTING=VALUE,…]", "Method to begin with.", "--method", "-m")
    ] = "adaptive",
    align_channels: Annotated[
        bool, options.option("", "Begin with a delay between angle and torque corrected.")
    ] = True,
    port: Annotated[int, options.option("N", "Port of the page; 0 for any that is free.")] = 0,
    browser: Annotated[
        bool,
        typer.Option(
            "--browser/--no-browser", metavar="", help="Whether to open the page in a browser."
        ),
    ] = True,
) -> None:
    """Open a page on which settings are chosen and their result is seen at once.

    Needs Shiny: `pip install 'tvsysid[explore]'`. The page has channels, period, decimation, method
    and settings. It shows stiffness with its band, the diagnosis, which method suits the data, and
    the `tvsysid identify` command and the Python that give the same. What is not given here is
    chosen there.

    Nothing leaves this computer: the page is at an address of its own (printed), with a secret in
    it, and asks no other host for anything. Ctrl-C closes it. On another computer: `ssh -L
    8000:127.0.0.1:8000 HOST`, and there `tvsysid explore FILE --port 8000 --no-browser`.

    Example: `tvsysid explore ankle.mat`

    Example: `tvsysid explore ankle.mat --angle pos --torque tq --rate 1000 --period 2
    --torque-sign -1`
    """
    given = {
        name: value for name, value in locals().items() if name not in ("file", "port", "browser")
    }
    from tvsysid.explorer import explore as opened

    running = opened(file, port=port, **given)
    say(f"{file.name} is explored at {running.url} (Ctrl-C ends it)")
    if browser and _has_screen():
        webbrowser.open(running.url)
    try:
        running.wait()
    except KeyboardInterrupt:
        running.close()
        sys.exit("interrupted; the page is closed")


def _has_screen() -> bool:
    """Whether a browser would show: without a screen, a text browser would take over the terminal."""
    if "SSH_CONNECTION" in os.environ:
        return False
    return sys.platform in ("win32", "darwin") or bool(
        {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys()
    )
