"""Page of what a diagnosis found in one or several recordings."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType

from tvsysid.errors import InputError
from tvsysid.figures import Illustration, Picture, diagnosis_panels, draw_all, recorded_signals
from tvsysid.figures.diagnosis import LOWEST
from tvsysid.preprocess import excerpt
from tvsysid.quality import Diagnosis
from tvsysid.report.page import render
from tvsysid.signals import Ensemble, Recording


def write_diagnosis(
    path: str | Path,
    diagnoses: Mapping[str, Diagnosis],
    command: str = "",
    recordings: Mapping[str, Illustration] = MappingProxyType({}),
    pictures: Mapping[str, Picture] | None = None,
) -> None:
    """Write one HTML file that holds all that was seen and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    diagnoses
        Of :func:`tvsysid.diagnose`, by the names of the ensembles.
    command
        What was typed, if it is to be mentioned.
    recordings
        Pictures of the recordings, by the names of their ensembles.
    pictures
        Pictures of the diagnoses, if they are drawn already.

    Raises
    ------
    InputError
        If there is no diagnosis.
    """
    if not diagnoses:
        raise InputError("write_diagnosis: expected diagnoses by name, got none")
    if pictures is None:
        pictures = {name: diagnosis_picture(each, name) for name, each in diagnoses.items()}
    render(
        path,
        "diagnosis.html",
        diagnoses=diagnoses,
        pictures=pictures,
        recordings=draw_all(recordings),
        command=command,
    )


def diagnosis_picture(diagnosis: Diagnosis, name: str) -> Picture:
    """Draw the six pictures of a diagnosis."""
    value, unit = diagnosis.measures["natural frequency"]
    text = (
        "Power of the angle over frequency, and the band from "
        f"{LOWEST:g} Hz to the joint's natural frequency of {value:.3g} {unit}. Power of the "
        "torque, and of what stiffness, viscosity and inertia leave of it. Coherence of torque and "
        "angle over time and frequency. Stiffness over time in the first and the second half of "
        "the experiment. Stiffness and noise of each realization over their median. Correlation of "
        "the torque left over with the angle and with the speed; by chance 95 % of them lie in "
        "the grey band. What is beyond it at positive lags is a reflex, a slow answer or a delay, "
        "at negative ones feedback. The tables have the numbers."
    )
    draw = partial(diagnosis_panels, diagnosis, name)
    return draw_all({name: Illustration(draw, f"Diagnosis of {name}", text)})[name]


def recording_illustration(recording: Recording, ensemble: Ensemble) -> Illustration:
    """Return some seconds of a recording with the starts of the realizations in it."""
    part, onsets = excerpt(recording), ensemble.onsets[ensemble.trials == ensemble.trials.min()]
    text = (
        f"Angle and torque as recorded, {part.duration:.3g} s of {recording.duration:.4g} s. "
        "Vertical lines: where realizations start."
    )
    draw = partial(recorded_signals, {"": part}, onsets=onsets)
    return Illustration(draw, "Recording and its realizations", text)
