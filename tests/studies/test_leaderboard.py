"""Test the leaderboard: frozen scenarios, scores, ties, and a page that stays the same.

The scores are compared with slow and closed forms.
"""

import hashlib
import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.stats import gmean
from tests.synthetic import SQUARE, results_of

import tvsysid as tv
from tvsysid.errors import InputError
from tvsysid.methods import CLOSED_LOOP, METHODS
from tvsysid.simulate import SYSTEMS
from tvsysid.studies import leaderboard

TINY = {
    "methods": ("sds", "lpv", "sds:window=0.1"), "trials": 2, "duration_s": 20.0, "snr_db": 10.0,
    "stiffness": "square", "perturbation": "noise", "viscosity": "constant", "system": "joint",
}  # fmt: skip
OWN = """
import numpy as np
import tvsysid as tv

class Spring:
    def simulate(self, duration, *, perturbation, snr_db, seed, rate=1000.0):
        joint = tv.simulate.Joint(stiffness=tv.simulate.Constant(80.0))
        return joint.simulate(duration, perturbation=perturbation, snr_db=snr_db, \
seed=seed, rate=rate)

SPRING = {"system": "own_scenarios:Spring", "perturbation": "prbs", "duration_s": 20, "snr_db": 10}
NUMBER = 3
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Offer a module with a scenario."""
    (tmp_path / "own_scenarios.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))


def digest(study):
    """Return a hash of the settings of each scenario, and of the size of its first seconds.

    The sizes show a change of a default or of a simulation, which no setting shows.
    """
    settings = f"{study.rate:g} Hz of {study.period:g} s, {study.subtract_mean}"
    lines = [f"{study.trials} trials at {settings}"]
    for scenario in study.scenarios:
        system, perturbation = study.simulated(scenario)
        seed, noise = np.random.SeedSequence(0), scenario.snr_db
        simulation = system.simulate(8.0, perturbation=perturbation, snr_db=noise, seed=seed)
        signals = simulation.recording.angle, simulation.recording.torque
        lines.append(" ".join([*map(str, scenario), *(f"{np.std(each):.3e}" for each in signals)]))
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def test_the_scenarios_of_the_version_are_those_that_were_frozen():
    study = leaderboard.study_of()
    assert digest(study) == "aea0ef10ed2fb7ec", "give what is changed a new version"
    assert (leaderboard.VERSION, len(study.scenarios), study.trials, study.seed) == (1, 13, 10, 1)
    kinds = {type(study.simulated(scenario)[0]) for scenario in study.scenarios}
    assert kinds == {type(system) for system in SYSTEMS.values()}


def test_errors_are_those_of_a_plain_loop():
    results = results_of(SQUARE[:2], ("eirf", "birf"), trials=3)
    values = results.estimate.values
    values[0, 1, 0] = np.nan  # nothing
    values[0, 2, 0, :, :50] = np.nan  # half of it left out
    values[1, 0, 1] = 1000.0  # worse than nothing
    expected = np.empty((2, 3, 2))
    for place in np.ndindex(*expected.shape):
        error = np.nan_to_num(values[place][0]) - results.truth.values[place[0], 0]
        expected[place] = min(1.0, np.sqrt(np.mean(error**2)) / 100.0)
    np.testing.assert_allclose(leaderboard.errors_of(results).values, expected, rtol=1e-12)
    assert (expected[0, 1, 0], expected[1, 0, 1]) == (1.0, 1.0)
    own = results.assign(trial_truth=results.truth * xr.DataArray([1.0, 2.0, 1.0], dims="trial"))
    found = leaderboard.errors_of(own).values
    np.testing.assert_allclose(found[:, ::2], expected[:, ::2], rtol=1e-12)
    assert found[1, 1, 1] > 0.5  # twice the stiffness was true


def test_the_score_is_a_geometric_mean_and_its_error_that_of_the_delta_method(random):
    errors = 0.1 * random.lognormal(0, 0.2, (4, 200, 1)) * random.lognormal(0, 0.1, (4, 200, 2))
    squares = xr.DataArray(errors**2, dims=("scenario", "trial", "method_key"))
    score = leaderboard.score_of(squares.mean("trial")).values
    np.testing.assert_allclose(score, 100 * gmean(np.sqrt((errors**2).mean(axis=1)), axis=0))
    replicates = leaderboard.replicates_of(np.sqrt(squares)).values
    influence = 0.5 * (squares / squares.mean("trial")).values * score / 4

    def delta(values):
        return np.sqrt((values.var(axis=1, ddof=1) / 200).sum(axis=0))

    np.testing.assert_allclose(replicates.std(axis=0), delta(influence), rtol=0.06)
    paired = delta(influence[..., 0] - influence[..., 1])
    assert (replicates[:, 0] - replicates[:, 1]).std() == pytest.approx(paired, rel=0.06)
    assert paired < 0.7 * np.hypot(*delta(influence))  # the same trials


def test_ranks_are_shared_with_the_leader_within_two_standard_errors():
    scores = np.array([4.0, 4.2, 4.5, 5.0, 9.0])
    noise = np.tile([-1.0, 1.0], 50)  # of one standard error
    replicates = scores + noise[:, None] * np.array([0.0, 0.2, 0.2, 0.2, 0.0])
    # 4.2 is within 0.4 of 4.0, 4.5 is not and leads; 5.0 moves as 4.5 does, so that their
    # difference is sure.
    assert leaderboard.ranks_of(scores, replicates) == [1, 1, 3, 4, 5]
    unknown = np.full((3, 5), np.nan)  # of one trial nothing is sure
    assert leaderboard.ranks_of(scores, unknown) == [1] * 5


@pytest.fixture
def tiny(own, monkeypatch):
    whole = leaderboard.study_of
    monkeypatch.setattr(
        leaderboard, "study_of", lambda *given, **also: whole(*given, **TINY | also)
    )


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_the_command_ranks_entries_in_scenarios_of_ones_own(tvsysid, tmp_path):
    secret = 3**50
    command = f"leaderboard --scenario own_scenarios:SPRING --seed {secret} --workers 1 --out out"
    code, out, err = tvsysid(command)
    assert code == 0, out + err
    assert "skipped" not in err
    assert "by trying" not in err
    table = pd.read_csv(tmp_path / "out" / "leaderboard.csv").set_index("entry")
    assert table["rank"].to_dict() == {"sds": 1, "sds:window=0.1": 1, "lpv": 3}
    assert table.score["lpv"] == 100
    by_scenario = table[["square-noise-20s-10dB", "own_scenarios_Spring-square-prbs-20s-10dB"]]
    np.testing.assert_allclose(table.score, gmean(by_scenario, axis=1), rtol=1e-5)
    text = (tmp_path / "out" / "leaderboard.html").read_text()
    assert "First: sds, sds:window=0.1." in text
    assert "lpv skipped 4 4" in " ".join(re.sub("<.+?>", " ", text).split())
    assert hashlib.sha256(f"tvsysid leaderboard 1 seed {secret}".encode()).hexdigest() in text
    assert str(secret) not in text + (tmp_path / "out" / "leaderboard.csv").read_text()
    assert "Not leaderboard 1: its scenarios or trials were changed." in text


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_the_page_is_the_same_whenever_and_wherever_it_is_made(tvsysid, tmp_path, monkeypatch):
    monkeypatch.setitem(TINY, "methods", ("birf", "sds"))
    pages = []
    for folder in ("one", "two", "one"):  # the last from what is kept
        assert tvsysid("leaderboard", "--seed", 7, "--workers", 1, "--out", folder)[0] == 0
        pages.append((tmp_path / folder / "leaderboard.html").read_bytes())
        (tmp_path / folder / "leaderboard.html").unlink()
    assert pages[0] == pages[1] == pages[2]
    assert b"which is public" not in pages[0]


@pytest.mark.usefixtures("own")
def test_scenarios_of_ones_own_are_in_studies_too(tmp_path):
    (tmp_path / "study.toml").write_text('also = ["own_scenarios:SPRING"]\nmethods = "sds"\n')
    study = tv.study.Study.from_toml(tmp_path / "study.toml")
    assert study.scenarios[-1].label == "own_scenarios_Spring-square-prbs-20s-10dB"
    entries = leaderboard.study_of(["sds:window=0.2"]).methods
    assert {*METHODS, *CLOSED_LOOP, "sds:window=0.2"} == set(entries)
    for name, said in (
        ("spin", "scenario 'spin': ModuleNotFoundError"),
        ("own_scenarios:NUMBER", "scenario 'own_scenarios:NUMBER' must be a table of settings"),
    ):
        with pytest.raises(InputError, match=said):
            leaderboard.study_of(scenarios=[name])
