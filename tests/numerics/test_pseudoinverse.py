import numpy as np
import pytest

from tvsysid.numerics import moments, pseudoinverse


@pytest.mark.parametrize("order", ["natural", "output"])
def test_rank_minimises_the_description_length(random, order):
    u, y = random.normal(size=(40, 30)), random.normal(size=(40, 30))
    u[:, 1:] += 0.95 * u[:, :-1]
    y += u
    phi_uu, phi_uy, square, _ = moments.lagged_moments(u, y, 4)
    solution = pseudoinverse.truncated(phi_uu, phi_uy, square, 40, order)
    for i in range(len(phi_uu)):
        left, values, _ = np.linalg.svd(phi_uu[i])
        projections = left.T @ phi_uy[i]
        explained = projections**2 / values
        ranking = np.argsort(-explained, kind="stable") if order == "output" else np.arange(9)
        costs = [
            (1 + d * np.log(40) / 40) * (square[i] - explained[ranking[:d]].sum())
            for d in range(1, 10)
        ]
        rank = int(np.argmin(costs)) + 1
        assert solution.rank[i] == rank
        kept = ranking[:rank]
        expected = left[:, kept] @ (projections[kept] / values[kept])
        np.testing.assert_allclose(solution.weights[i], expected, atol=1e-10)


def test_fewer_realizations_than_lags_give_the_minimum_norm(random):
    u, y = random.normal(size=(4, 30)), random.normal(size=(4, 30))
    phi_uu, phi_uy, _, _ = moments.lagged_moments(u, y, 3)
    solution = pseudoinverse.full(phi_uu, phi_uy)
    np.testing.assert_array_equal(solution.rank, 4)
    lagged = np.stack([u[:, 10 - lag] for lag in range(-3, 4)], axis=1)
    np.testing.assert_allclose(solution.weights[7], np.linalg.pinv(lagged) @ y[:, 10], atol=1e-6)
