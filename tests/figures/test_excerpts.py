import attrs
import numpy as np
from tests.drawing import draw
from tests.experimental import prepared_of, results_of

from tvsysid.figures import recorded_signals
from tvsysid.figures.saving import drawn
from tvsysid.figures.style import TARGET


def excerpts_of(person, perturbations, **words):
    results = results_of((person,), perturbations, methods=("sds",), bootstraps=1)
    return [each.excerpt for each in prepared_of(results, **words)]


def test_angle_and_torque_with_the_target_over_ten_seconds():
    noise, prbs = excerpts_of("P1", ("noise", "prbs"))
    figure = recorded_signals({"filtered noise": noise, "PRBS": prbs}, "Signals")
    draw(figure)
    angle, torque, _, last = figure.axes
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["filtered noise"] * 2 + [
        "PRBS"
    ] * 2
    assert (angle.get_ylabel(), torque.get_ylabel()) == ("angle (rad)", "torque (N·m)")
    assert last.get_xlabel() == "time (s)"
    np.testing.assert_array_equal(angle.lines[0].get_ydata(), noise.angle)
    np.testing.assert_allclose(angle.lines[0].get_xdata(), noise.time)
    np.testing.assert_array_equal(torque.lines[0].get_ydata(), noise.torque)
    np.testing.assert_array_equal(torque.lines[1].get_ydata(), noise.channels["target"])
    assert torque.lines[1].get_color() == TARGET
    assert [text.get_text() for text in figure.legends[0].texts] == ["torque to be followed"]
    assert angle.get_ylim() == figure.axes[2].get_ylim()


def test_without_a_target_there_is_no_legend():
    (excerpt,) = excerpts_of("S1", ("steps",), rate=100.0)
    excerpt = attrs.evolve(excerpt, channels={})
    figure = recorded_signals({"S1": excerpt})
    content = drawn(figure, "svg")
    assert len(figure.axes) == 2
    assert len(figure.axes[1].lines) == 1
    assert not figure.legends
    assert len(content) < 300_000
    marked = recorded_signals({"S1": excerpt}, onsets=[18.0, 20.5, 22.5, 31.0]).axes[0]
    assert [line.get_xdata()[0] for line in marked.lines[1:]] == [20.5, 22.5]
