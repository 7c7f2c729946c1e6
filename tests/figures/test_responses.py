import numpy as np
from tests.drawing import draw
from tests.synthetic import responses_of

from tvsysid.figures import impulse_responses
from tvsysid.figures.style import lines


def test_truth_below_and_methods_in_their_colours():
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
        assert truth.get_linewidth() > 2 * found[0].get_linewidth()


def test_long_labels_and_one_instant():
    methods = (
        "sds:window=0.2,max_lag=0.1",
        "mine:AMethodWithANameThatHardlyEverSeemsToEnd",
        "eirf",
        "birf",
        "own",
    )
    figure = impulse_responses(responses_of(methods).isel(instant=[0]))
    draw(figure)
    legend = figure.legends[0].get_window_extent()
    assert legend.y1 <= figure.axes[0].get_window_extent().y0
    assert legend.x0 >= 0
    assert legend.x1 <= figure.bbox.x1
