"""`tvsysid explore`."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import attrs

from tvsysid.cli.console import say
from tvsysid.cli.options import ReadingOptions, SegmentationOptions, given
from tvsysid.recordings.reading import Reading, Segmentation


def explore(
    file: Path,
    /,
    *,
    reading: ReadingOptions = Reading(),
    segmentation: SegmentationOptions = Segmentation(),
    method: str = "adaptive",
    port: int = 0,
    browser: bool = True,
) -> None:
    """Open a page on which settings are chosen and their result is seen at once.

    The page has channels, period, decimation, method
    and settings. It shows stiffness with its band, the diagnosis, which method suits the data, and
    the `tvsysid identify` command and the Python that give the same. What is not given here is
    chosen there; the page begins with data decimated to 100 Hz.

    Nothing leaves this computer: the page is at an address of its own (printed), with a secret in
    it, and asks no other host for anything. Ctrl-C closes it. On another computer: `ssh -L
    8000:127.0.0.1:8000 HOST`, and there `tvsysid explore FILE --port 8000 --no-browser`.

    Example: `tvsysid explore ankle.mat`

    Example: `tvsysid explore ankle.mat --angle angle --torque torque --rate 1000 --period 2
    --torque-sign -1`

    Parameters
    ----------
    file
        MAT, CSV, TSV, NPZ, HDF5, NetCDF, NWB, Motion-BIDS, Parquet, C3D or EDF file.
    method
        Method to begin with, with settings after a colon if you wish.
    port
        Port of the page; 0 for any that is free.
    browser
        Whether to open the page in a browser.
    """
    from tvsysid.explorer import explore as open_page

    page = open_page(
        file,
        port=port,
        method=method,
        **given(**attrs.asdict(reading), **attrs.asdict(segmentation)),
    )
    say(f"{file.name} is explored at {page.url} (Ctrl-C ends it)")
    if browser:
        webbrowser.open(page.url)
    try:
        page.wait()
    finally:
        page.close()
