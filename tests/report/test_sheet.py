"""A sheet of A4 about one person."""

import attrs
import pytest
from tests.report.conftest import write_visit
from tests.report.elements import Elements, table

import tvsysid as tv


def test_visits_stand_in_their_order_with_their_bands(sheet_page, identified):
    elements = Elements(sheet_page.read_text())
    assert (
        "Research use only. Not for diagnosis, and not for decisions about treatment."
    ) in sheet_page.read_text()
    told = table(elements, "Means over time")
    model = identified.models["adaptive"]
    lower, upper = model.estimates["stiffness"].band()
    for place in range(1, 7):
        mean = f"{model.stiffness.mean():.1f} ± {(upper - lower).mean() / 2:.1f}"
        assert (
            f"{place}. visit number {place} 60 × 2 s adaptive {mean} "
            f"{identified.answer.difference:.1f} {model.stiffness.min():.1f} at " in told
        )
    # The held-out VAF is unknown, and the data have no fault
    assert told.endswith("–none none")


@pytest.mark.slow
@pytest.mark.usefixtures("sketched")
def test_one_visit_says_its_answer(identified, tmp_path):
    write_visit(tmp_path, identified)
    tv.report.write_sheet(tmp_path / "sheet.html", [tmp_path])
    told = " ".join(text for _, text in Elements((tmp_path / "sheet.html").read_text()).of("p"))
    assert "Recommended (adaptive): stiffness " in told
    assert "Person: ____" in told


@pytest.mark.usefixtures("sketched")
def test_a_visit_without_a_valid_stiffness_says_why_and_has_no_numbers(
    sheet_page, identified, tmp_path
):
    visits = [sheet_page.parent / "visit number 1", tmp_path / "biased"]
    withdrawn = attrs.evolve(identified, unnamed_references=["Channel 'command' moves the angle."])
    write_visit(visits[1], withdrawn)
    for folders, name in (([visits[1]], "<ankle>.mat"), (visits, "2. biased")):
        tv.report.write_sheet(tmp_path / "sheet.html", folders)
        told = Elements((tmp_path / "sheet.html").read_text())
        box = " ".join(text for _, text in told.of("p"))
        assert "No stiffness is stated. Channel 'command' moves the angle." in box
        assert f"{name} 60 × 2 s adaptive{' not valid' * 6}" in table(told, "Means over time")


def test_what_identify_did_not_write_is_refused(tmp_path):
    with pytest.raises(tv.InputError, match="expected 1 to 6 folders of tvsysid identify, got 0"):
        tv.report.write_sheet(tmp_path / "sheet.html", [])
    for content in (None, "text"):
        if content is not None:
            (tmp_path / "models.nc").write_text(content)
        with pytest.raises(tv.InputError, match=r"did not write this folder.* again"):
            tv.report.write_sheet(tmp_path / "sheet.html", [tmp_path])
