"""Recordings and models from and to files."""

from tvsysid.recordings.atomic import whole_file
from tvsysid.recordings.read import read_recording
from tvsysid.recordings.write import write_models, write_simulation

__all__ = ["read_recording", "whole_file", "write_models", "write_simulation"]
