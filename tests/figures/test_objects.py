"""Everything that has a picture shows it, and a line in a notebook."""

import sys
from contextlib import nullcontext

import numpy as np
import pytest
from tests import experimental, synthetic
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.errors import InputError
from tvsysid.figures.style import panels
from tvsysid.showing import Shown, reported, summary_html


@pytest.fixture(scope="module")
def ensemble():
    return ensemble_of(40.0, "sine", "prbs")


@pytest.fixture(scope="module")
def comparison(ensemble):
    return tv.compare(ensemble, ["sds", "esm"])


def labels(figure):
    return [axes.get_ylabel().partition("\n")[0].partition(" (")[0] for axes in figure.axes]


def test_recording_and_ensemble(ensemble):
    recording = tv.Recording(ensemble.angle.ravel(), ensemble.torque.ravel(), 100.0)
    figure = recording.plot("a joint")
    assert labels(figure) == ["angle", "torque"]
    assert figure.get_suptitle() == "a joint"
    assert "10 s from the middle" in figure.axes[0].get_title("left")
    first = ensemble.plot().axes[0]
    shown = ensemble.angle[:, ensemble.core]
    np.testing.assert_array_equal(
        [line[:, 1] for line in first.collections[0].get_segments()], shown
    )
    np.testing.assert_array_equal(first.lines[0].get_ydata(), shown.mean(axis=0))


def test_comparison_and_model(comparison):
    impedance = ["stiffness", "viscosity", "inertia"]
    figure = comparison.plot()
    assert labels(figure) == ["stiffness", "time-varying VAF", *impedance[1:]]
    figure = comparison.models["sds"].plot()
    assert labels(figure) == impedance  # without an ensemble there is no VAF
    assert [text.get_text() for text in figure.legends[0].texts] == ["sds"]


def test_results_of_both_kinds():
    results = synthetic.results_of([("square", "noise", 40.0, 10.0)], ("sds", "kbr"), trials=2)
    assert labels(tv.figures.plot(results)) == ["stiffness", "", "time-varying VAF", ""]
    several = experimental.results_of(("P1",), methods=("sds", "kbr"), bootstraps=2)
    assert labels(tv.figures.plot(several)) == ["filtered noise", "PRBS", "torque"]
    assert labels(tv.figures.plot(several.isel(recording=[0]))) == ["stiffness", "", "torque"]


def test_what_has_no_picture():
    with pytest.raises(InputError, match=r"expected a recording, ensemble, .*, got int"):
        tv.figures.plot(1)


def test_a_figure_shows_itself_without_pyplot():
    content, size = panels(1, 1, 2.0, 1.0)[0]._repr_png_()
    assert content.startswith(b"\x89PNG")
    assert size == {"width": 192, "height": 96}
    assert int.from_bytes(content[16:20], "big") == 2 * size["width"]


def test_one_line_of_html_for_each(ensemble, comparison):
    for each in (ensemble, comparison.models["sds"], comparison):
        assert isinstance(each, Shown)
        text = each._repr_html_()
        assert text.startswith(f"<p><b>{type(each).__name__}</b>: ")
        assert "realizations of 2 s" in text or "stiffness" in text
    assert comparison._repr_html_().count("<tr>") == 3
    joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
    simulation = joint.simulate(2, perturbation=tv.simulate.PRBS(), snr_db=10, seed=1)
    assert simulation._repr_html_().startswith("<p><b>Simulation</b>: Recording(4 s at 1000 Hz")
    assert labels(simulation.plot()) == ["angle", "torque"]
    choice = tv.methods.Choice(tv.ShortDataSegments(window=0.2), "better <by> 3")
    assert "ShortDataSegments(" in choice._repr_html_()
    assert choice._repr_html_().endswith("better &lt;by&gt; 3</p>")


def test_what_others_wrote_is_escaped_and_long_tables_are_folded():
    text = summary_html("<b>", "<i>", ["<u>"], [["<s>"], [float("nan")], [1 / 3]], ["<script>\x1b"])
    assert not any(tag in text for tag in ("<i>", "<u>", "<s>", "<script>", "\x1b", "<b><b>"))
    assert "></td>" in text
    assert "0.3333" in text
    assert "<details>" not in text
    assert "<summary>30 rows</summary>" in summary_html("many", "", ["n"], [[n] for n in range(30)])


def test_progress_goes_to_who_asks_for_it_and_to_a_notebook(monkeypatch):
    told = []
    with reported(lambda *counts: told.append(counts), "working") as advance:
        advance(1, 2)
    with reported(None, "working") as advance:  # no notebook
        advance(1, 2)
    assert told == [(1, 2)]
    monkeypatch.setitem(sys.modules, "ipykernel", object())
    monkeypatch.setattr("tvsysid.showing.find_spec", lambda name: object())
    monkeypatch.setattr(
        "tvsysid.showing.progress_bar",
        lambda title: nullcontext(lambda *counts: told.append(title)),
    )
    with reported(None, "working") as advance:
        advance(2, 2)
    assert told == [(1, 2), "working"]
