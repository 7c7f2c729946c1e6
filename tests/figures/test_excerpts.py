import numpy as np
from tests.drawing import draw
from tests.experimental import excerpts_of, results_of

from tvsysid.figures import recorded_signals
from tvsysid.figures.saving import drawn
from tvsysid.figures.style import TARGET


def test_angle_and_torque_with_the_target_over_ten_seconds():
    given = excerpts_of(results_of(("P1",), methods=("sds",), bootstraps=1))
    figure = recorded_signals(
        {"filtered noise": given["P1-noise"], "PRBS": given["P1-prbs"]}, "Signals"
    )
    draw(figure)
    angle, torque, _, last = figure.axes
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["filtered noise"] * 2 + [
        "PRBS"
    ] * 2
    assert (angle.get_ylabel(), torque.get_ylabel()) == ("angle (rad)", "torque (N·m)")
    assert last.get_xlabel() == "time (s)"
    recording = given["P1-noise"]
    np.testing.assert_array_equal(angle.lines[0].get_ydata(), recording.angle)
    np.testing.assert_allclose(angle.lines[0].get_xdata(), recording.time - 20.0)
    np.testing.assert_array_equal(torque.lines[0].get_ydata(), recording.torque)
    np.testing.assert_array_equal(torque.lines[1].get_ydata(), recording.channels["target"])
    assert torque.lines[1].get_color() == TARGET
    assert [text.get_text() for text in figure.legends[0].texts] == ["torque to be followed"]
    assert angle.get_ylim() == figure.axes[2].get_ylim()


def test_without_a_target_there_is_no_legend():
    given = excerpts_of(
        results_of(("S1",), ("steps",), ("sds",), (30,), 1), target=False, rate=100.0
    )
    figure = recorded_signals(given)
    content = drawn(figure, "svg")
    assert len(figure.axes) == 2
    assert len(figure.axes[1].lines) == 1
    assert not figure.legends
    assert len(content) < 300_000
