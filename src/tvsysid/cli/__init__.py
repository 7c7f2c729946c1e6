"""The command line: parses, calls, prints; no science."""

from tvsysid.cli.app import main

__all__ = ["main"]
