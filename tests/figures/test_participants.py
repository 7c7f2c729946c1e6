import numpy as np
import pytest
from tests.drawing import draw
from tests.experimental import METHODS, fail, results_of

from tvsysid import InputError
from tvsysid.figures import participant_in_detail, stiffness_of_participants, stiffness_with_bands
from tvsysid.figures.style import TRUTH, lines

HUES = {method: look.hue for method, look in lines(list(METHODS)).items()}


@pytest.fixture(scope="module")
def results():
    return results_of()


@pytest.fixture(scope="module")
def detail(results):
    """Of P2, drawn."""
    figure = participant_in_detail(results, "P2", "P2")
    draw(figure)
    return figure


def labelled(axes, label):
    return [line for line in axes.lines if line.get_label() == label]


def texts(axes):
    return [text.get_text() for text in axes.texts]


def legend(figure):
    return [text.get_text() for text in figure.legends[0].texts]


@pytest.mark.slow
def test_every_participant_has_a_column_and_every_perturbation_a_row(results):
    figure = stiffness_of_participants(results, "All")
    draw(figure)
    noise, prbs, torque = np.array(figure.axes).reshape(3, 3)
    assert [axes.get_title() for axes in noise] == ["P1", "P2", "P3"]
    assert noise[0].get_ylabel() == "filtered noise\nstiffness\n(N·m/rad)"
    assert prbs[0].get_ylabel() == "PRBS\nstiffness\n(N·m/rad)"
    assert torque[0].get_ylabel() == "torque\n(N·m)"
    assert all(axes.get_xlabel() == "time (s)" for axes in torque)
    assert len({axes.get_ylim() for axes in (*noise, *prbs)}) == 1
    assert len({axes.get_ylim() for axes in torque}) == 1
    assert figure.get_suptitle() == "All"
    assert legend(figure) == [
        "eirf, 75 × 2 s", "sds, 75 × 2 s", "birf, 75 × 2 s", "esm, 75 × 2 s", "kbr, 20 × 2 s",
        "truth", "torque to be followed", "mean torque, filtered noise", "mean torque, PRBS",
    ]  # fmt: skip


def test_lines_are_means_over_bootstraps_of_the_least_data(results):
    figure = stiffness_of_participants(results)
    axes = figure.axes[4]  # P2, PRBS
    for line, (method, hue) in zip(axes.lines[1:], HUES.items(), strict=True):
        chosen = results.sel(
            recording="P2-prbs", analysis=f"{method}-{20 if method == 'kbr' else 75}"
        )
        np.testing.assert_allclose(
            line.get_ydata(), chosen.estimate.sel(quantity="stiffness").values.mean(axis=0)
        )
        assert line.get_color() == hue
    (truth,) = labelled(axes, "truth")
    np.testing.assert_array_equal(
        truth.get_ydata(), results.truth.sel(quantity="stiffness").sel(recording="P2-prbs")
    )


def test_torque_below(results):
    lines = stiffness_of_participants(results).axes[7].lines
    mean = results.mean_torque.values[2:4]
    np.testing.assert_array_equal([lines[0].get_ydata(), lines[2].get_ydata()], mean)
    np.testing.assert_array_equal(lines[1].get_ydata(), results.target_torque.values[2])


@pytest.mark.slow
def test_of_a_failed_recording_nothing_is_drawn():
    failed = fail(results_of(methods=("sds", "esm")), "InputError: too short", recording="P2-noise")
    figure = stiffness_of_participants(failed)
    draw(figure)
    assert all(np.isnan(line.get_ydata()).all() for line in figure.axes[1].lines[1:])
    assert texts(figure.axes[1]) == ["no estimate"]
    assert np.isnan(figure.axes[7].lines[0].get_ydata()).all()


@pytest.mark.slow
def test_a_recording_that_was_never_made_says_so(results):
    figure = stiffness_of_participants(results.sel(recording=["P1-noise", "P1-prbs", "P2-prbs"]))
    draw(figure)
    assert texts(figure.axes[1]) == ["not recorded"]


@pytest.mark.slow
def test_without_truth_and_target_neither_is_mentioned():
    results = results_of(("S1",), ("noise",), ("sds", "esm"), truth=False, target=False)
    for figure in (stiffness_of_participants(results), participant_in_detail(results, "S1")):
        draw(figure)
        assert not {"truth", "torque to be followed"} & set(legend(figure))
    nothing = results.assign(mean_torque=results.mean_torque * np.nan)
    assert len(stiffness_of_participants(nothing).axes) == 1
    assert len(participant_in_detail(nothing, "S1").axes) == 2 * 2


@pytest.mark.slow
def test_many_participants_are_shown_six_abreast():
    results = results_of(
        tuple(f"P{n}" for n in range(1, 14)), ("noise",), ("sds",), (75,), bootstraps=2
    )
    figure = stiffness_of_participants(results)
    draw(figure)
    shown = [axes for axes in figure.axes if axes.axison]
    assert len(shown) == 2 * 13
    assert {axes.get_title() for axes in shown} == {f"P{n}" for n in range(1, 14)} | {""}
    assert figure.get_figwidth() < 11
    assert [axes.get_ylabel() for axes in shown if axes.get_ylabel()].count("torque\n(N·m)") == 3


def test_details_of_a_participant(results, detail):
    grid, behind = np.array(detail.axes[:20]).reshape(4, 5), detail.axes[20:]
    assert [axes.get_title() for axes in grid[0]] == [
        "eirf, 75 × 2 s", "sds, 75 × 2 s", "birf, 75 × 2 s", "esm, 75 × 2 s", "kbr, 20 × 2 s",
    ]  # fmt: skip
    assert [axes.get_ylabel() for axes in grid[:, 0]] == [
        "filtered noise\nstiffness\n(N·m/rad)", "PRBS\nstiffness\n(N·m/rad)",
        "filtered noise\ntime-varying VAF\n(%)", "PRBS\ntime-varying VAF\n(%)",
    ]  # fmt: skip
    for row, (name, signal) in enumerate(
        (name, signal) for name in ("estimate", "time_varying_vaf") for signal in ("noise", "prbs")
    ):
        for column, method in enumerate(METHODS):
            chosen = (
                results.sel(quantity="stiffness")[name]
                .sel(recording=f"P2-{signal}", analysis=f"{method}-{20 if method == 'kbr' else 75}")
                .values
            )
            axes = grid[row, column]
            mean = axes.lines[-1]
            np.testing.assert_allclose(mean.get_ydata(), chosen.mean(axis=0))
            assert mean.get_color() == HUES[method]
            top = axes.collections[0].get_paths()[0].vertices[:, 1].max()
            band = chosen.mean(axis=0) + 2 * chosen.std(axis=0, ddof=1)
            assert top == pytest.approx(min(band.max(), 100) if row > 1 else band.max())
            truth = labelled(axes, "truth")
            assert [line.get_color() for line in truth] == ([TRUTH] if row < 2 else [])
    assert grid[0, 0].get_ylim() == grid[1, 0].get_ylim()
    assert {axes.get_ylim() for axes in grid[2:].ravel()} == {(0, 102)}
    for axes in behind:
        np.testing.assert_array_equal(axes.lines[0].get_ydata(), results.target_torque.values[2])
    assert [axes.get_ylabel() for axes in behind] == (["", "", "", "", "torque (N·m)"] * 4)


def test_a_single_bootstrap_has_no_band():
    results = results_of(("S1",), ("noise",), ("sds",), (75,), bootstraps=1)
    assert "the only bootstrap" in legend(participant_in_detail(results, "S1"))


@pytest.mark.slow
def test_a_failed_method_in_detail():
    failed = fail(results_of(("P1",), methods=("sds", "esm")), "no", analysis="esm-75")
    figure = participant_in_detail(failed, "P1")
    draw(figure)
    assert texts(figure.axes[1]) == texts(figure.axes[5]) == ["no estimate"]


def test_bands_of_one_recording_in_one_row(results):
    figure = stiffness_with_bands(results, "P3-prbs")
    draw(figure)
    assert figure.get_figwidth() == pytest.approx(18 / 2.54, abs=0.01)  # two columns of a journal
    chosen = (
        results.estimate.sel(quantity="stiffness")
        .sel(recording="P3-prbs", analysis="birf-75")
        .values
    )
    np.testing.assert_allclose(figure.axes[2].lines[-1].get_ydata(), chosen.mean(axis=0))
    assert legend(figure) == [
        "mean over bootstraps",
        "± 2 standard deviations",
        "truth",
        "torque to be followed",
    ]
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.x1


def test_who_is_not_there_is_named(results):
    with pytest.raises(InputError, match="no participant 'P9'; there are P1, P2, P3"):
        participant_in_detail(results, "P9")
    with pytest.raises(InputError, match="no recording 'P9-noise'; there are P1-noise, "):
        stiffness_with_bands(results, "P9-noise")


@pytest.mark.slow
def test_a_method_that_is_far_off_does_not_hide_the_others_but_a_stiffer_person_is_shown(results):
    far = results.copy(deep=True)
    far["estimate"][:, 0] *= 20  # eirf
    assert participant_in_detail(far, "P1").axes[0].get_ylim()[1] < 400
    assert stiffness_of_participants(far).axes[0].get_ylim()[1] < 400
    stiff = results.copy(deep=True)
    stiff["estimate"][results.participant.values == "P2"] *= 4
    assert stiffness_of_participants(stiff).axes[0].get_ylim()[1] > 4 * 140
