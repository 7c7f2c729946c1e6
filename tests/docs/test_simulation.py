"""What docs/simulation.md says is so."""

import re
from pathlib import Path

import numpy as np

import tvsysid as tv

TEXT = (Path(__file__).parents[2] / "docs" / "simulation.md").read_text(encoding="utf-8")


def test_the_example_runs():
    (code,) = re.findall(r"^```python\n(.+?)\n^```", TEXT, re.MULTILINE | re.DOTALL)
    names = {}
    exec(code, names)
    simulation, ensemble = names["simulation"], names["ensemble"]
    truth = simulation.truth_of(ensemble)["stiffness"]
    np.testing.assert_allclose(truth, np.tile(tv.simulate.SineWave()(ensemble.time), (20, 1)), rtol=1e-9)


def test_the_table_says_what_each_system_gives():
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in re.findall(r"^\| `\w+` \|.*$", TEXT, re.M)]
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
