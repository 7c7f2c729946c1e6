"""`tvsysid methods` and `tvsysid check-method`."""

import pytest


def test_methods_are_listed_with_what_they_assume(tvsysid):
    code, out, _ = tvsysid("methods")
    assert code == 0
    for words in (
        "max_lag=0.12",
        "same in all realizations",
        "nearly periodic",
        "For repeated movements",
        "For two pathways",
        "For closed loops",
        "For a scheduling variable",
        "For special perturbations",
        "needs: the disturbance that was applied",
        "a perturbation of this kind: multisine",
        "reports: stiffness, viscosity, inertia",
    ):
        assert words in out


OWN = """
import numpy as np
import tvsysid as tv


class Constant(tv.Method):
    def fit(self, ensemble):
        angle, torque = ensemble.angle[:, ensemble.core], ensemble.torque[:, ensemble.core]
        return np.sum(angle * torque) / np.sum(angle * angle)
"""


@pytest.mark.slow
def test_check_method_says_what_is_wrong(tvsysid, tmp_path):
    (tmp_path / "own_for_cli.py").write_text(OWN)
    code, out, err = tvsysid("check-method own_for_cli:Constant")
    assert (code, err) == (1, "")
    assert "✗ identifies a joint: Constant: fit returned an object of type float64; " in out
    assert out.endswith("\nown_for_cli:Constant does not pass\n")
