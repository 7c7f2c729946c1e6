"""What all pages have in common: they need nothing else, and a screen reader finds its way."""

import base64
import re
from itertools import pairwise
from xml.etree import ElementTree

import pytest
from tests.report.conftest import HOSTILE
from tests.report.elements import Elements

PAGES = ("page", "experiment_page", "identification_page", "diagnosis_page", "sheet_page")


@pytest.fixture(params=PAGES)
def text(request):
    return request.getfixturevalue(request.param).read_text()


def test_a_page_needs_nothing_else_and_is_read_aloud_in_order(text):
    elements = Elements(text)
    assert elements.open == []
    assert "default-src 'none'" in text
    assert "url(" not in text
    assert HOSTILE not in text
    assert len(elements.of("script")) <= 1
    for _, attrs, _ in elements.found:
        for name in ("src", "href", "srcset", "action", "data", "poster"):
            assert attrs.get(name, "#").startswith(("#", "data:")), attrs
    assert elements.of("html")[0][0] == {"lang": "en"}
    assert len(elements.of("h1")) == len(elements.of("main")) == len(elements.of("title")) == 1
    levels = [int(tag[1]) for tag, _, _ in elements.found if re.fullmatch("h[1-6]", tag)]
    assert all(after <= before + 1 for before, after in pairwise(levels))
    identifiers = [attrs["id"] for _, attrs, _ in elements.found if "id" in attrs]
    assert len(identifiers) == len(set(identifiers))
    assert all(attrs["href"][1:] in identifiers for attrs, _ in elements.of("a"))
    assert len(elements.of("caption")) == len(elements.of("table"))
    assert all("nan" not in words for _, words in elements.of("table", "figcaption"))
    assert all(attrs["scope"] in ("row", "col") for attrs, _ in elements.of("th"))
    regions = [attrs for attrs, _ in elements.of("div") if attrs.get("class") == "scroll"]
    assert len(regions) == sum(len(elements.of(tag)) for tag in ("table", "img"))
    assert all((each["role"], each["tabindex"]) == ("region", "0") for each in regions)
    images = [attrs for attrs, _ in elements.of("img")]
    assert len(images) == len(elements.of("figcaption")) > 0
    for image in images:
        kind, _, content = image["src"].partition(",")
        assert kind == "data:image/svg+xml;base64"
        assert ElementTree.fromstring(base64.b64decode(content)).tag.endswith("svg")
        assert "described below" in image["alt"]
