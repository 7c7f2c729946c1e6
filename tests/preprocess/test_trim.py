import numpy as np
import pytest

import tvsysid as tv


def two_trials():
    values = np.arange(1500.0)
    return tv.Recording(
        values, -values, 100.0, start=3.0, channels={"target": 2 * values}, trial_starts=(0, 700)
    )


def test_ends_go_and_time_begins_where_the_rest_does():
    trimmed = tv.preprocess.trim(two_trials(), ends=1.0, margin=0.25)
    expected = np.concatenate([np.arange(75, 625), np.arange(775, 1425)])
    np.testing.assert_array_equal(trimmed.angle, expected)
    np.testing.assert_array_equal(trimmed.torque, -expected)
    np.testing.assert_array_equal(trimmed.channels["target"], 2 * expected)
    assert trimmed.trial_starts == (0, 550)
    np.testing.assert_allclose(trimmed.time[[0, 25, 550]], [-0.25, 0.0, -0.25])


def test_margins_keep_the_realizations_at_the_ends():
    cut = tv.preprocess.segment(
        tv.preprocess.trim(two_trials(), 1.0, margin=0.5), period=1.0, context=0.5
    )
    assert (len(cut), cut.left_out) == (5 + 6, 0)
    np.testing.assert_array_equal(
        cut.angle[:, cut.core][:, 0], [*range(100, 600, 100), *range(800, 1400, 100)]
    )


@pytest.mark.parametrize(
    ("ends", "margin", "message"),
    [
        (1.0, 1.5, "a margin of 1.5 s cannot be kept of ends of 1 s"),
        (3.5, 0.0, "ends of 3.5 s leave nothing of a trial of 7 s"),
        (-1.0, 0.0, "ends must be a number of seconds"),
        (1.0, float("nan"), "margin must be a number of seconds"),
    ],
)
def test_what_cannot_be_trimmed_is_refused(ends, margin, message):
    with pytest.raises(tv.InputError, match=message):
        tv.preprocess.trim(two_trials(), ends, margin)
