"""Reference results of a refactoring: what is written is read, and a difference is found."""

import numpy as np
import pytest
from benchmarks import frozen

RESULTS = {
    "methods/square/sds/stiffness": np.array([np.nan, 50.0, 100.0]),
    "methods/square/sds/stiffness_freedom": np.array([np.inf, 3.0]),
    "methods/square/sds/warnings": "few realizations\nslow noise",
    "plan/default/minutes": np.array(2.5),
}


def test_what_is_written_is_read(tmp_path, capsys):
    frozen.write(RESULTS, tmp_path / "old.nc")
    assert frozen.report(frozen.read(tmp_path / "old.nc", ["methods", "plan"]), RESULTS, 0.0) == 0
    assert list(frozen.read(tmp_path / "old.nc", ["plan"])) == ["plan/default/minutes"]
    assert "0 of 4 quantities differ" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("path", "changed", "told"),
    [
        ("methods/square/sds/stiffness", np.array([np.nan, 50.0, 100.001]), "stiffness 1.0e-05"),
        (
            "methods/square/sds/stiffness",
            np.array([1.0, 50.0, 100.0]),
            "stiffness: NaN at other places",
        ),
        ("methods/square/sds/stiffness", np.zeros(4), "stiffness: shape (3,), now (4,)"),
        ("methods/square/sds/warnings", "few realizations\nloud noise", "+ loud noise"),
        ("plan/default/minutes", None, "minutes: gone"),
    ],
)
def test_a_difference_is_found(capsys, path, changed, told):
    new = {name: value for name, value in {**RESULTS, path: changed}.items() if value is not None}
    assert frozen.report(RESULTS, new, 1e-9) == 1
    assert told in capsys.readouterr().out


def test_a_new_quantity_is_no_difference(capsys):
    assert frozen.report(RESULTS, {**RESULTS, "plan/default/hours": np.array(0.1)}, 1e-9) == 0
    assert "plan/default/hours: new" in capsys.readouterr().out
