"""Recordings and models from and to files."""

from tvsysid.recordings.channel import Channel, outline
from tvsysid.recordings.formats import describe_file
from tvsysid.recordings.read import UsableTrials, join_trials, read_recording, read_trials, read_usable_trials
from tvsysid.recordings.write import (
    load_ensemble,
    load_recording,
    whole_file,
    write_ensemble,
    write_models,
    write_recording,
    write_simulation,
)

__all__ = ["Channel", "UsableTrials", "describe_file", "join_trials", "load_ensemble", "load_recording", "outline"]
__all__ += ["read_recording", "read_trials", "read_usable_trials", "whole_file", "write_ensemble", "write_models"]
__all__ += ["write_recording", "write_simulation"]
