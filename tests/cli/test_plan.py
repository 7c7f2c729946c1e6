"""`tvsysid plan`."""

from scipy.io import savemat
from tests.conftest import ensemble_of


def test_plan_from_a_pilot(tvsysid, tmp_path, monkeypatch, sketched):
    monkeypatch.setattr("tvsysid.planning.Protocol.sizes", (10, 40))
    ensemble = ensemble_of(40.0, "sine", "noise")
    signals = {
        name: ensemble.signal(name)[:, ensemble.core].ravel() for name in ("angle", "torque")
    }
    savemat(tmp_path / "pilot.mat", signals)
    code, shown, errors = tvsysid(
        "plan --pilot pilot.mat --angle angle --torque torque --rate 100 --method birf --method "
        "sds:window=0.6 --precision 6 --resolution 0.25 --out planned"
    )
    assert (code, errors) == (0, "")
    assert "pilot: stiffness by adaptive 4" in shown
    assert (
        "To know stiffness to ± 6 N·m/rad at 95 % and follow a change within 0.25 s, with birf and "
        "the" in shown
    )
    assert "sds:window=0.6 does not suffice: its bias alone is" in shown
    assert (tmp_path / "planned" / "plan.png").read_bytes().startswith(b"\x89PNG")
    table = (tmp_path / "planned" / "plan.csv").read_text(encoding="utf-8").splitlines()
    assert table[0].startswith("setup,method,realizations,record (s),± noise,± bias")
    assert len(table) == 3
