"""How a simulated recording is identified on the command line."""

import importlib
import re
from functools import cache

import pytest
from scipy.io import savemat
from tests import faults

from tvsysid.errors import InputError
from tvsysid.recommendation import Recommendation


def rows_of(out):
    """Cells of the lines of tables, with empty ones left out."""
    return [re.split(r" {2,}", line.strip()) for line in out.splitlines()]


def text_of(page):
    """Text of a page without its tags."""
    return re.sub("<[^>]+>", "", page.read_text())


IDENTIFY = "--angle angle --torque torque --rate 1000 --decimate 100 --period 2"


@cache
def simulated():
    """Signals of a simulated joint, 40 s at 1000 Hz."""
    recording = faults.simulated(40.0, profile="square", seed=0)
    return {"angle": recording.angle[1000:-1000], "torque": recording.torque[1000:-1000]}


@pytest.fixture
def joint(tvsysid):
    """Put a simulated recording of 40 s into joint.mat; return angle and torque."""
    savemat("joint.mat", simulated() | {"sampling_rate": 1000.0}, oned_as="column")
    return simulated()


@pytest.fixture
def not_held_out(monkeypatch):
    """Without held-out VAF, which takes five more identifications by each method.

    Other tests have it.
    """
    monkeypatch.setattr(
        "tvsysid.comparison.Comparison.predict_held_out", lambda *given, **words: {}
    )


@pytest.fixture
def only_identified(monkeypatch, not_held_out):
    """Nor with diagnosis and recommendation, which take longer than most methods."""

    importlib.import_module("tvsysid.studies.van_de_ruit_2021.experiment")  # before it is replaced

    def undiagnosed(*given, **words):
        raise InputError("it is not diagnosed")

    monkeypatch.setattr("tvsysid.quality.diagnose", undiagnosed)
    monkeypatch.setattr("tvsysid.comparison.preparation.diagnose", undiagnosed)
    recommended = Recommendation(("adaptive",), "for any data")
    monkeypatch.setattr(
        "tvsysid.comparison.comparison.recommend", lambda *given, **words: recommended
    )
