"""The page in a real browser: sorting, pictures, a phone's width, paper."""

import json
import re
import shutil
import subprocess

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FRAME = """<!DOCTYPE html>
<html><body><pre id="seen"></pre><script>
const frame = document.createElement("iframe");
frame.width = 360; frame.height = 800; frame.style.border = 0;
frame.srcdoc = PAGE;
const seen = { broken: [] };
frame.onload = async () => {
  const view = frame.contentWindow, page = view.document;
  CHECKS
  seen.broken = view.broken;
  document.getElementById("seen").textContent = JSON.stringify(seen);
};
document.body.append(frame);
</script></body></html>"""
WATCH = """<script>
window.broken = [];
window.addEventListener("error", (event) => window.broken.push(String(event.message)), true);
window.addEventListener("securitypolicyviolation", (event) => window.broken.push(event.violatedDirective));
</script>"""
CHECKS = """
  seen.width = page.documentElement.scrollWidth;
  seen.columns = [...page.querySelectorAll("#ranking-table thead th")].map((cell) => cell.textContent);
  seen.images = [...page.images].map((image) => image.complete && image.naturalWidth > 0);
  const rows = () => [...page.querySelectorAll("#ranking-table tbody tr")];
  const buttons = [...page.querySelectorAll("#ranking-table thead button")];
  const count = page.getElementById("count");
  seen.chosen = [rows().filter((row) => !row.hidden).length, count.textContent];
  const choice = page.getElementById("scenario");
  choice.value = ""; choice.dispatchEvent(new Event("change"));
  seen.all = rows().filter((row) => !row.hidden).length;
  seen.sorted = buttons.map((button, column) => [1, 2].map(() => {
    button.click();
    const heading = button.parentElement;
    return {
      sort: heading.getAttribute("aria-sort"),
      others: page.querySelectorAll("[aria-sort]").length,
      texts: rows().map((row) => row.cells[column].textContent),
      numbers: rows().map((row) => row.cells[column].dataset.value ?? null),
    };
  }));
  const scrolling = [...page.querySelectorAll(".scroll")].filter((box) => box.scrollWidth > box.clientWidth);
  scrolling.forEach((box) => box.focus());
  seen.focused = page.activeElement === scrolling.at(-1);
"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip(f"no browser is installed: {', '.join(BROWSERS)}")
    profile = tmp_path_factory.mktemp("profile")

    def run(*words):
        options = ("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", f"--user-data-dir={profile}")
        command = [found, *options, "--enable-logging=stderr", *map(str, words)]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)

    return run


@pytest.fixture(scope="module")
def seen(browser, page, tmp_path_factory):
    """What a browser sees in the page at a phone's width."""
    content = page.read_text().replace("<meta http-equiv", f"{WATCH}<meta http-equiv", 1)
    framed = FRAME.replace("CHECKS", CHECKS).replace("PAGE", json.dumps(content).replace("</", "<\\/"))
    file = tmp_path_factory.mktemp("framed") / "framed.html"
    file.write_text(framed)
    done = browser("--virtual-time-budget=5000", "--dump-dom", file.as_uri())
    assert "CONSOLE" not in done.stderr, done.stderr
    (text,) = re.findall(r'<pre id="seen">(.*?)</pre>', done.stdout, re.DOTALL)
    return json.loads(text.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))


def test_no_errors_and_nothing_refused(seen):
    assert seen["broken"] == []


def test_pictures_are_shown(seen):
    assert len(seen["images"]) > 3
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
    data = seen["sorted"][2][0]["texts"]
    assert data == ["40"] * 4 + ["80"] * 4 + ["150"] * 4


def test_it_prints(browser, page, tmp_path):
    browser("--no-pdf-header-footer", f"--print-to-pdf={tmp_path / 'page.pdf'}", page.as_uri())
    content = (tmp_path / "page.pdf").read_bytes()
    assert content.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", content)) > 3
