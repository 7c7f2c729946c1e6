import dataclasses
import os

import pytest
import xarray as xr

import tvsysid as tv
from tvsysid.study import Study, run

SMALL = {"duration_s": [60.0], "trials": 3, "methods": ["sds", "kbr"]}


def same(one, other):
    """Compare results but for their times, which are not the same twice."""
    xr.testing.assert_identical(one.drop_vars("seconds"), other.drop_vars("seconds"))


@dataclasses.dataclass(frozen=True)
class Mine(tv.Method):
    """A researcher's own method, which ends its process if it is told to."""

    fault: str = ""

    def fit(self, ensemble):
        if self.fault == "dies":
            os._exit(9)
        return tv.Model.of(ensemble, 100.0)


@pytest.fixture(scope="session")
def results():
    return run(Study(**SMALL), workers=1)
