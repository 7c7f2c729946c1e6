import base64
from itertools import pairwise
from xml.etree import ElementTree

import pytest
from tests import faults
from tests.faults import cut, simulated
from tests.report.conftest import HOSTILE
from tests.report.elements import Elements

import tvsysid as tv
from tvsysid.errors import InputError
from tvsysid.quality import FAULTS
from tvsysid.report import write_diagnosis


@pytest.fixture(scope="module")
def diagnoses():
    recording = simulated(60.0)
    return {"clean": tv.diagnose(cut(recording)), HOSTILE: tv.diagnose(cut(faults.late(recording)))}


@pytest.fixture(scope="module")
def page(diagnoses, tmp_path_factory):
    path = tmp_path_factory.mktemp("diagnosis") / "diagnosis.html"
    write_diagnosis(path, diagnoses, "tvsysid inspect ankle.mat --diagnose && echo")
    return path


@pytest.fixture(scope="module")
def elements(page):
    elements = Elements(page.read_text())
    assert elements.open == []
    return elements


def test_it_needs_nothing_else(page, elements):
    text = page.read_text()
    assert "http://" not in text
    assert "https://" not in text
    assert "<script" not in text
    assert HOSTILE not in text
    for _, attrs, _ in elements.found:
        for name in ("src", "href"):
            assert attrs.get(name, "#").startswith(("#", "data:"))
    assert [path.name for path in page.parent.iterdir()] == ["diagnosis.html"]


def test_headings_anchors_and_regions(elements):
    levels = [int(tag[1]) for tag, _, _ in elements.found if tag in ("h1", "h2", "h3", "h4")]
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    identifiers = [attrs["id"] for _, attrs, _ in elements.found if "id" in attrs]
    assert len(identifiers) == len(set(identifiers))
    for attrs, _ in elements.of("a"):
        assert attrs["href"][1:] in identifiers
    assert len(elements.of("caption")) == len(elements.of("table")) == 5
    assert all(attrs["scope"] in ("row", "col") for attrs, _ in elements.of("th"))


def test_findings_with_effect_and_remedy(elements):
    found = next(text for _, text in elements.of("table") if "What was found in" in text)
    for part in (
        FAULTS["delay"].title,
        FAULTS["delay"].effect,
        FAULTS["delay"].remedy,
        "ms late",
        "at most 0.75",
    ):
        assert part in found


def test_everything_that_was_looked_at_is_there(elements):
    tables = [
        text for _, text in elements.of("table") if text.startswith("All that was looked for")
    ]
    assert len(tables) == 2
    for text in tables:
        # These three need other data
        assert all(name in text for name in FAULTS if name not in ("loop-bias", "gaps", "mains"))
    assert "not judged not judged" not in " ".join(tables[0].replace("–", " ").split())
    assert "Not judged: mean-torque, mean-angle (the mean over" in " ".join(
        text for _, text in elements.of("p")
    )
    assert "✗ found" in tables[1]
    assert "✗ found" not in tables[0]


def test_pictures_are_inside(elements):
    images = [attrs for attrs, _ in elements.of("img")]
    assert len(images) == 2
    for image in images:
        assert ElementTree.fromstring(
            base64.b64decode(image["src"].partition(",")[2])
        ).tag.endswith("svg")


@pytest.mark.slow
@pytest.mark.usefixtures("sketched")
def test_the_command_is_told_if_there_is_one(elements, diagnoses, tmp_path):
    assert [text for _, text in elements.of("pre")] == [
        "tvsysid inspect ankle.mat --diagnose && echo"
    ]
    write_diagnosis(tmp_path / "page.html", {"clean": diagnoses["clean"]})
    assert "This command made the page" not in (tmp_path / "page.html").read_text()


def test_no_diagnosis_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected diagnoses by name, got"):
        write_diagnosis(tmp_path / "page.html", {})
    assert not list(tmp_path.iterdir())
