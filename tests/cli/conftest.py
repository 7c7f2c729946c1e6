"""How a simulated recording is identified on the command line."""

import pytest

IDENTIFY = ("--angle", "angle", "--torque", "torque", "--rate", 1000, "--decimate", 100, "--period", 2)


@pytest.fixture
def not_held_out(monkeypatch):
    """Without held-out VAF, which takes five more identifications by each method; other tests have it."""
    monkeypatch.setattr("tvsysid.comparison.Comparison.held_out_vaf", lambda *given, **words: {})
