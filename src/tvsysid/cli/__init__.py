"""The command line: parses, calls, prints; no science."""

from tvsysid.cli.start import main

__all__ = ["main"]
