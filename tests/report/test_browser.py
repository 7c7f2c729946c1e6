"""The page in a real browser: sorting, pictures, a phone's width, paper."""

import re

import pytest
from tests.report.browsing import look

pytestmark = pytest.mark.slow

CHECKS = """
  seen.width = page.documentElement.scrollWidth;
  seen.columns = [...page.querySelectorAll("#ranking-table thead th")]\
.map((cell) => cell.textContent);
  seen.images = [...page.images].map((image) => image.complete && image.naturalWidth > 0);
  const rows = () => [...page.querySelectorAll("#ranking-table tbody tr")];
  const buttons = [...page.querySelectorAll("#ranking-table thead button")];
  const count = page.querySelector(".chooser [role=status]");
  seen.chosen = [rows().filter((row) => !row.hidden).length, count.textContent];
  const choice = page.getElementById("ranking-table-choice");
  choice.value = ""; choice.dispatchEvent(new Event("change"));
  seen.all = rows().filter((row) => !row.hidden).length;
  const number = (cell) => cell.classList.contains("number")
    ? cell.textContent.replace("−", "-").replace("–none", "").split(" ")[0] : null;
  seen.sorted = buttons.map((button, column) => [1, 2].map(() => {
    button.click();
    const heading = button.parentElement;
    return {
      sort: heading.getAttribute("aria-sort"),
      others: page.querySelectorAll("[aria-sort]").length,
      texts: rows().map((row) => row.cells[column].textContent),
      numbers: rows().map((row) => number(row.cells[column])),
    };
  }));
  const scrolling = [...page.querySelectorAll(".scroll")]\
.filter((box) => box.scrollWidth > box.clientWidth);
  scrolling.forEach((box) => box.focus());
  seen.focused = page.activeElement === scrolling.at(-1);
"""


@pytest.fixture(scope="module")
def seen(browser, page, tmp_path_factory):
    """What a browser sees in the page at a phone's width."""
    return look(browser, page, CHECKS, tmp_path_factory.mktemp("framed"))


def test_no_errors_and_nothing_refused(seen):
    assert seen["broken"] == []


def test_pictures_are_shown(seen):
    assert len(seen["images"]) == 3
    assert all(seen["images"])


def test_a_phone_scrolls_tables_but_not_the_page(seen):
    assert seen["width"] <= 360
    assert seen["focused"]


def test_one_scenario_is_shown_first_and_all_on_demand(seen):
    assert seen["chosen"] == [4, "4 of 12 rows"]
    assert seen["all"] == 12


def test_headings_sort(seen):
    assert len(seen["sorted"]) == len(seen["columns"]) == 10
    for column in seen["sorted"]:
        assert [state["sort"] for state in column] == ["ascending", "descending"]
        assert [state["others"] for state in column] == [1, 1]


def test_numbers_sort_as_numbers_and_the_missing_come_last(seen):
    numeric = 0
    for rising, falling in seen["sorted"]:
        if None in rising["numbers"]:
            assert rising["texts"] == sorted(rising["texts"])
            continue
        numeric += 1
        for state, sign in ((rising, 1), (falling, -1)):
            there = [sign * float(number) for number in state["numbers"] if number]
            assert there == sorted(there)
            assert state["numbers"][len(there) :] == [""] * (len(state["numbers"]) - len(there))
    assert numeric == 8


SHOWN = """
  seen.width = page.documentElement.scrollWidth;
  seen.images = [...page.images].map((image) => image.complete && image.naturalWidth > 0);
"""


@pytest.mark.parametrize(("name", "pictures"), [("identification_page", 2), ("experiment_page", 6)])
def test_other_pages_are_shown_on_a_phone(browser, request, tmp_path, name, pictures):
    seen = look(browser, request.getfixturevalue(name), SHOWN, tmp_path)
    assert (seen["broken"], seen["images"]) == ([], [True] * pictures)
    assert seen["width"] <= 360


def test_a_sheet_is_one_page_of_paper(browser, sheet_page, tmp_path):
    browser(
        "--no-pdf-header-footer", f"--print-to-pdf={tmp_path / 'sheet.pdf'}", sheet_page.as_uri()
    )
    assert len(re.findall(rb"/Type\s*/Page\b", (tmp_path / "sheet.pdf").read_bytes())) == 1
