"""Reference results of a refactoring: what is written is read, and a difference is found."""

import numpy as np
from benchmarks import frozen

RESULTS = {
    "methods/square/sds/stiffness": np.array([np.nan, 50.0, 100.0]),
    "methods/square/sds/stiffness_freedom": np.array([np.inf, 3.0]),
    "methods/square/sds/warnings": "few realizations\nslow noise",
    "plan/default/minutes": np.array(2.5),
}


def test_what_is_written_is_read_and_a_difference_is_found(tmp_path, capsys):
    frozen.write(RESULTS, tmp_path / "old.nc")
    old = frozen.read(tmp_path / "old.nc", ["methods", "plan"])
    assert frozen.report(old, RESULTS | {"plan/default/hours": np.array(0.1)}, 0.0) == 0
    changed = {"methods/square/sds/stiffness": np.array([np.nan, 50.0, 100.001])}
    changed |= {"methods/square/sds/warnings": "few realizations\nloud noise"}
    assert frozen.report(old, changed, 1e-9) == 4
    told = capsys.readouterr().out
    for words in ("stiffness 1.0e-05", "+ loud noise", "plan/default/minutes: gone", "hours: new"):
        assert words in told
