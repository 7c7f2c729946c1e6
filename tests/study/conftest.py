import dataclasses
import os

import numpy as np
import pytest

import tvsysid as tv
from tvsysid.study import Study, run

SMALL = {"duration_s": [60.0], "trials": 3, "methods": ["sds", "kbr"]}
TIMES = ["seconds"]  # variables that are not the same twice


@dataclasses.dataclass(frozen=True)
class Mine(tv.Method):
    """A researcher's own method: a constant joint's stiffness by regression on the angle alone.

    Or it goes wrong.
    """

    fault: str = ""

    def fit(self, ensemble):
        if self.fault == "dies":
            os._exit(9)
        angle, torque = ensemble.angle[:, ensemble.core], ensemble.torque[:, ensemble.core]
        return tv.Model.of(ensemble, np.sum(angle * torque) / np.sum(angle * angle))


@pytest.fixture(scope="session")
def results():
    return run(Study(**SMALL), workers=1)
