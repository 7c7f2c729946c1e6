import numpy as np
from tests.drawing import draw
from tests.synthetic import responses_of

from tvsysid.figures import impulse_responses
from tvsysid.figures.style import lines


def test_truth_below_and_methods_dashed_in_their_colours():
    responses = responses_of()
    figure = impulse_responses(responses, "Impulse responses")
    draw(figure)
    assert [axes.get_title() for axes in figure.axes] == [
        "k = 50 N·m/rad, at 0.25 s",
        "k = 150 N·m/rad, at 1 s",
    ]
    assert figure.axes[0].get_ylabel() == "impulse response (N·m/(rad·s))"
    for number, axes in enumerate(figure.axes):
        assert axes.get_xlabel() == "lag (s)"
        truth, *found = axes.lines
        np.testing.assert_array_equal(truth.get_ydata(), responses.true_impulse_response[number])
        assert [line.get_color() for line in found] == [
            look["color"] for look in lines(["eirf", "sds", "birf"]).values()
        ]
        assert all(line.is_dashed() for line in found)
        assert truth.get_linewidth() > 2 * found[0].get_linewidth()
