"""Test the leaderboard: frozen scenarios, scores, ties, and a page that stays the same."""

import hashlib
import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.stats import gmean
from tests.synthetic import SQUARE, results_of

from tvsysid.errors import InputError
from tvsysid.methods import CLOSED_LOOP, METHODS
from tvsysid.simulate import SYSTEMS
from tvsysid.studies import leaderboard
from tvsysid.study.scenarios import Scenario


def digest(study):
    """Return a hash of the settings of each scenario, and of the size of its first seconds.

    The sizes show a change of a default or of a simulation, which no setting shows.
    """
    settings = f"{study.rate:g} Hz of {study.period:g} s, {study.subtract_mean}"
    lines = [f"{study.trials} trials at {settings}"]
    for scenario in study.scenarios:
        system = study.system_of(scenario)
        perturbation = study.parts["perturbation"][scenario.perturbation]
        seed, noise = np.random.SeedSequence(0), scenario.snr_db
        simulation = system.simulate(8.0, perturbation=perturbation, snr_db=noise, seed=seed)
        signals = simulation.recording.angle, simulation.recording.torque
        lines.append(" ".join([*map(str, scenario), *(f"{np.std(each):.3e}" for each in signals)]))
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def test_the_scenarios_of_the_version_are_those_that_were_frozen():
    study = leaderboard.study_of(["sds:window=0.2"])
    assert digest(study) == "aea0ef10ed2fb7ec", "give what is changed a new version"
    assert (leaderboard.VERSION, len(study.scenarios), study.trials, study.seed) == (1, 13, 10, 1)
    kinds = {type(study.system_of(scenario)) for scenario in study.scenarios}
    assert kinds == {type(system) for system in SYSTEMS.values()}
    assert {*METHODS, *CLOSED_LOOP, "sds:window=0.2"} == set(study.methods)


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


def test_the_score_is_a_geometric_mean_and_its_error_that_of_a_bootstrap(random):
    errors = 0.1 * random.lognormal(0, 0.2, (4, 200, 1)) * random.lognormal(0, 0.1, (4, 200, 2))
    score, influence = leaderboard.score_of(errors), leaderboard.influence_of(errors)
    np.testing.assert_allclose(score, 100 * gmean(np.sqrt((errors**2).mean(axis=1)), axis=0))
    weights = random.multinomial(200, np.full(200, 1 / 200), (2000, 4)) / 200
    squares = np.einsum("dst,ste->dse", weights, errors**2)
    drawn = 100 * np.exp(0.5 * np.log(squares).mean(axis=1))
    alone = leaderboard.standard_error(influence)
    np.testing.assert_allclose(alone, drawn.std(axis=0), rtol=0.06)
    paired = leaderboard.standard_error(influence[..., 0] - influence[..., 1])
    assert paired == pytest.approx((drawn[:, 0] - drawn[:, 1]).std(), rel=0.06)
    assert paired < 0.7 * np.hypot(*alone)  # the same trials


def test_ranks_are_shared_with_the_leader_within_two_standard_errors():
    scores = np.array([4.0, 4.2, 4.5, 5.0, 9.0])
    # Of a hundred trials, for a standard error of 0.2
    noise = np.tile([-1.0, 1.0], 50)[:, None] * [0.0, 4.0, 4.0, 4.0, 0.0]
    errors = np.sqrt(scores**2 + noise * scores) / 100
    # 4.2 is within 0.4 of 4.0; 4.5 is not, and leads. 5.0 moves as 4.5 does: their difference is
    # sure.
    assert leaderboard.ranks_of(errors[None]) == [1, 1, 3, 4, 5]
    with pytest.raises(InputError, match="one trial cannot rank methods"):
        leaderboard.study_of(trials=1)


@pytest.fixture
def tiny(monkeypatch):
    monkeypatch.setattr(
        leaderboard, "SCENARIOS", {"imposed angle": (Scenario("square", "noise", 20.0, 10.0),)}
    )
    whole = leaderboard.study_of
    methods = "sds", "lpv", "sds:window=0.1"
    monkeypatch.setattr(
        leaderboard, "study_of", lambda _, **also: whole(**{"methods": methods, "trials": 2} | also)
    )


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
def test_the_page_is_the_same_whenever_and_wherever_it_is_made(tvsysid, tmp_path):
    secret, pages = 3**50, []
    for folder in ("one", "two", "one"):  # the last from what is kept
        code, out, err = tvsysid("leaderboard", "--seed", secret, "--workers", 1, "--out", folder)
        assert code == 0, out + err
        assert "skipped" not in err
        pages.append((tmp_path / folder / "leaderboard.html").read_text())
        (tmp_path / folder / "leaderboard.html").unlink()
    text, csv = pages[0], tmp_path / "one" / "leaderboard.csv"
    assert pages == [text] * 3
    table = pd.read_csv(csv).set_index("entry")
    assert table["rank"].to_dict() == {"sds": 1, "sds:window=0.1": 1, "lpv": 3}
    assert table.score["lpv"] == 100
    np.testing.assert_allclose(table.score, table["square-noise-20s-10dB"], rtol=1e-5)
    assert "First: sds, sds:window=0.1." in text
    assert "lpv skipped 2 2" in " ".join(re.sub("<.+?>", " ", text).split())
    assert hashlib.sha256(f"tvsysid leaderboard 1 seed {secret}".encode()).hexdigest() in text
    assert str(secret) not in text + csv.read_text()
    assert "which is public" not in text
    assert "Not leaderboard 1: it has fewer or more trials." in text
