import dataclasses
import os
import sys

import numpy as np
import pytest

import tvsysid as tv
from tvsysid.study import Study, run

SMALL = {"duration_s": [60.0], "trials": 3, "methods": ["sds", "kbr"]}
TIMES = ["seconds", "other_seconds"]
"""Variables that are not the same twice."""


@dataclasses.dataclass(frozen=True)
class Mine(tv.Method):
    """A researcher's own method: a constant joint's stiffness by regression on the angle alone.

    Or it goes wrong.
    """

    fault: str = ""

    def fit(self, ensemble):
        if self.fault == "raises" and len(ensemble) == 40:
            raise ZeroDivisionError("no such luck")
        if self.fault == "exits":
            sys.exit(3)
        if self.fault == "dies":
            os._exit(9)
        angle, torque = ensemble.angle[:, ensemble.core], ensemble.torque[:, ensemble.core]
        gain = np.nan if self.fault == "nothing" else np.sum(angle * torque) / np.sum(angle * angle)
        return tv.Model.of(ensemble, np.full(ensemble.samples, gain))


@pytest.fixture(scope="session")
def results():
    return run(Study(**SMALL), workers=1)
