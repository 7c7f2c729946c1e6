"""The page of an experiment in a real browser."""

import pytest
from tests.report.browsing import look

pytestmark = pytest.mark.slow

CHECKS = """
  seen.width = page.documentElement.scrollWidth;
  seen.images = [...page.images].map((image) => image.complete && image.naturalWidth > 0);
  const rows = () => [...page.querySelectorAll("#metrics-table tbody tr")];
  const buttons = [...page.querySelectorAll("#metrics-table thead button")];
  const number = (cell) => cell.classList.contains("number")
    ? cell.textContent.replace("−", "-").replace("–none", "").split(" ")[0] : null;
  seen.sorted = buttons.map((button, column) => {
    button.click();
    return {
      sort: button.parentElement.getAttribute("aria-sort"),
      numbers: rows().map((row) => number(row.cells[column])),
    };
  });
"""


@pytest.fixture(scope="module")
def seen(browser, experiment_page, tmp_path_factory):
    """What a browser sees in the page at a phone's width."""
    return look(browser, experiment_page, CHECKS, tmp_path_factory.mktemp("framed"))


def test_nothing_breaks_and_pictures_are_shown(seen):
    assert seen["broken"] == []
    assert seen["images"] == [True] * 5


def test_a_phone_scrolls_tables_but_not_the_page(seen):
    assert seen["width"] <= 360


def test_headings_sort_by_numbers(seen):
    assert len(seen["sorted"]) == 12
    for state in seen["sorted"]:
        assert state["sort"] == "ascending"
        numbers = [float(number) for number in state["numbers"] if number]
        assert numbers == sorted(numbers)
    assert sum(None not in state["numbers"] for state in seen["sorted"]) == 10
