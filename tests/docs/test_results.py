"""What the page on results lists is what a benchmark writes."""

import re
from pathlib import Path

import pytest
from tests.synthetic import results_of, summary_of

from tvsysid.studies.van_de_ruit_2021 import STUDY
from tvsysid.study import Study, run
from tvsysid.study.scores import COLUMNS, METRICS

OF_EXPERIMENT = ("participant", "realizations", "bootstraps")
PAGE = (Path(__file__).parents[2] / "docs" / "results.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## (\S+)\n\n(.+?)(?=\n## |\Z)", PAGE, re.MULTILINE | re.DOTALL))


def quoted(text):
    return re.findall(r"`([^`]+)`", text)


def test_columns_of_the_summary():
    before, _, _ = SECTIONS["summary.csv"].partition("\n|")
    assert [name for name in quoted(before) if name != "results.nc"] == [
        name for name in COLUMNS if name not in OF_EXPERIMENT
    ]


def test_every_metric_is_explained_once():
    told = []
    for row in re.findall(r"^\| (`.+?) \|", SECTIONS["summary.csv"], re.MULTILINE):
        first, *others = quoted(row)
        told += [first, *(name.replace("...", first) for name in others)]
    assert sorted(told) == sorted({*METRICS, "mean_stiffness"} - {"mean"})


def test_every_variable_of_the_store_is_named():
    text = SECTIONS["results.nc"]
    readers = {'tv.study.read_results("tvsysid-benchmark")', "xarray.open_dataset", "tasks/"}
    settings = {"system": "reflex", "perturbation": "prbs", "methods": "pc"}
    results = run(Study(duration_s=20, trials=1, **settings), workers=1)
    assert {*results.data_vars, "trial_truth", "asked"} == set(quoted(text)) - readers


@pytest.mark.slow
def test_every_kind_of_figure_is_named():
    results = results_of()
    kinds = {stem.partition("-")[0] for stem in STUDY.figures(results, summary_of(results))}
    kinds |= {"bias"}  # of tests.studies.test_literature
    assert {name.partition("-")[0] for name in quoted(SECTIONS["figures/"])} == kinds
