"""Systems, profiles and perturbations of a user's own, and the names of objects in results."""

import sys

import pytest

import tvsysid as tv
from tvsysid.methods import (
    from_text,
    label_of,
    load,
)

OBJECTS = """
from dataclasses import dataclass


@dataclass(frozen=True)
class Joint:
    viscosity: float = 2.2

    def simulate(self, duration, perturbation, snr_db, seed, rate=1000.0):
        return self


def profile(time):
    return 100 + 0 * time


class Steps:
    def generate(self, samples, rate, random):
        return random.standard_normal(samples)
"""


@pytest.fixture
def objects(tmp_path, monkeypatch):
    (tmp_path / "objects_for_tests.py").write_text(OBJECTS)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("objects_for_tests", None)


@pytest.mark.usefixtures("objects")
def test_systems_profiles_and_perturbations_of_ones_own():
    module = "objects_for_tests"
    assert from_text(f"{module}:Joint:viscosity=3", "system").viscosity == 3.0
    assert load(f"{module}:Joint") is type(from_text(f"{module}:Joint", "system"))
    assert from_text(f"{module}:profile", "profile") is load(f"{module}:profile")
    assert type(from_text(f"{module}:Steps", "perturbation")).__name__ == "Steps"


@pytest.mark.usefixtures("objects")
@pytest.mark.parametrize(
    ("text", "what", "message"),
    [
        (
            "objects_for_tests:Steps",
            "system",
            r"^system 'objects_for_tests:Steps': Steps has no simulate",
        ),
        ("objects_for_tests:Ankle", "system", r"has no 'Ankle'; its systems are Joint$"),
        (
            "objects_for_tests:profile:a=1",
            "profile",
            r"unknown setting 'a'",
        ),
        (
            "objects_for_tests:Joint:viscosity=low",
            "system",
            r"^system .*: viscosity must be a number, got 'low'",
        ),
    ],
)
def test_what_is_no_system_profile_or_perturbation_is_refused(text, what, message):
    with pytest.raises(tv.InputError, match=message):
        from_text(text, what)


@pytest.mark.parametrize(
    ("item", "label"),
    [("sds:window=0.2", "sds:window=0.2"), (tv.ShortDataSegments(), None), (object(), "object")],
)
def test_label_in_results(item, label):
    assert label_of(item) == (label or repr(item))
