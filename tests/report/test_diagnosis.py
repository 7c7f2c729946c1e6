import pytest
from tests.report.elements import Elements

from tvsysid.errors import InputError
from tvsysid.quality import FAULTS
from tvsysid.report import write_diagnosis


@pytest.fixture(scope="module")
def elements(diagnosis_page):
    return Elements(diagnosis_page.read_text())


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
