import numpy as np
import pytest

import tvsysid as tv
from tvsysid.preprocess import Account


def ensemble_of(count):
    values = np.random.default_rng(0).normal(size=(count, 10))
    return tv.Ensemble(
        values, values, 100.0, onsets=2.0 * np.arange(count), trials=np.arange(count) // 3
    )


def test_accounts_add_up_to_one_row_for_each_realization():
    ensemble = ensemble_of(6)
    first = Account.of(ensemble, "alignment", np.array([0.0, 0.4, 0.1, 0.0, 0.0, 0.3]), 0.25, "s")
    second = Account.of(
        ensemble.select(first.kept), "residual", np.array([1.0, 2.0, 3.5, 1.0]), 3.0, "SD"
    )
    both = first + second
    np.testing.assert_array_equal(both.kept, [True, False, True, False, True, False])
    table = both.table
    assert list(table.excluded_by) == ["", "alignment", "", "residual", "", "alignment"]
    assert table.loc[3].to_dict() == {
        "trial": 1,
        "onset_s": 6.0,
        "shift_s": 0.0,
        "excluded_by": "residual",
        "reached": 3.5,
        "limit": 3.0,
        "unit": "SD",
    }
    assert both.counts == {"alignment": 2, "residual": 1}
    assert (
        repr(both) == "Account(3 of 6 realizations kept; excluded: 2 by alignment, 1 by residual)"
    )


def test_accounts_in_the_wrong_order_are_refused():
    first = Account.of(ensemble_of(6), "alignment", np.arange(6.0), 3.0, "s")
    with pytest.raises(
        tv.InputError, match="the first step kept 4 realizations, but the second was given 6"
    ):
        _ = first + first
