"""What docs/simulation.md says is so."""

import re
import shlex
import sys

import numpy as np
import pandas as pd
import pytest
from tests.docs.pages import blocks, text_of

import tvsysid as tv

EXAMPLE, OWN = blocks("simulation.md")


def test_the_example_runs():
    names = {}
    exec(EXAMPLE, names)
    simulation, ensemble = names["simulation"], names["ensemble"]
    truth = simulation.truth_of(ensemble)["stiffness"]
    np.testing.assert_allclose(
        truth, np.tile(tv.simulate.SineWave()(ensemble.time), (20, 1)), rtol=1e-9
    )


def test_the_table_says_what_each_system_gives():
    rows = [
        [cell.strip() for cell in row.strip("|").split("|")]
        for row in re.findall(r"^\| `\w+` \|.*$", text_of("simulation.md"), re.M)
    ]
    rows = [[kind, name, *others] for kind, names, *others in rows for name in names.split(", ")]
    assert {name for _, name, *_ in rows if name} == set(tv.simulate.SYSTEMS)
    for kind, name, _, truth, pathways, channel in rows:
        system = tv.simulate.SYSTEMS[name] if name else tv.simulate.Participant(1)
        assert type(system).__name__ == kind.strip("`")
        settings = {"perturbation": tv.simulate.PRBS()}
        if name:
            settings |= {"duration": 4, "snr_db": 10, "seed": 1}
        simulation = system.simulate(**settings)
        assert set(simulation.truth) == {"stiffness", "viscosity", "inertia"} | ({truth} - {""})
        assert ", ".join(simulation.pathways) == pathways
        assert [f"`{name}`" for name in simulation.recording.channels] == channel.split()[:1]


@pytest.mark.slow
@pytest.mark.usefixtures("sketched")
@pytest.mark.parametrize("number", [0, 1])
def test_ones_own_profile_perturbation_and_joint_are_simulated(
    tvsysid, tmp_path, monkeypatch, number
):
    (tmp_path / "mine.py").write_text(OWN, encoding="utf-8")
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    (commands,) = blocks("simulation.md", "")
    _, *words = shlex.split(commands.splitlines()[number])
    more = ["--duration", "20", "--trials", "1", "--workers", "1"]
    more += [] if "birf" in words else ["--method", "birf"]
    assert tvsysid(*words, *more)[0] == 0
    table = pd.read_csv(tmp_path / words[-1] / "summary.csv")
    own = ("mine:ramp", "mine:Multisine") if number == 0 else ("sine", "noise")
    assert (table.stiffness == own[0]).all()
    assert own[1] in set(table.perturbation)
    assert (table.system == ("joint" if number == 0 else "mine:DragJoint")).all()
    assert table[table.metric == "bias_error"].value.between(0.1, 30).all()
