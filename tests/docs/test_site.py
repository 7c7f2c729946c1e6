"""The site's own pages: what they tell you to type works, and each is in a section."""

import importlib
import re
import shlex

import pytest
from tests.docs.pages import DOCS, blocks, run, text_of


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")
@pytest.mark.usefixtures("undrawn", "sketched")
def test_five_minutes_from_a_file_to_a_picture(tvsysid, tmp_path):
    _, simulate, inspect, save, identify, diagnose = blocks("start.md", "")
    for command in (simulate, inspect, save, f"{identify} --method birf", diagnose):
        code, out, err = tvsysid(*shlex.split(command)[1:])
        assert code == 0, out + err
    assert (tmp_path / "tvsysid-identify" / "stiffness.csv").stat().st_size > 1000
    run("start.md")


def test_options_of_protocols_are_there(tvsysid):
    told = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text_of("protocols.md")))
    shown = "".join(tvsysid(command, "--help")[1] for command in ("identify", "inspect"))
    assert told
    assert not {option for option in told if option not in shown}


def test_methods_of_the_decision_table_are_there():
    import tvsysid as tv

    table = text_of("which-method.md").split("## The evidence")[0]
    words = set(
        re.findall(r"`((?:kbr|lpv|cascade|eirf|sds|birf|esm|adaptive)(?::[\w=,]+)?)`", table)
    )
    assert len(words) > 8
    for word in words:
        tv.methods.parse(word)


def test_every_page_is_in_a_section():
    lists = "\n".join(
        text_of(f"{name}.md") for name in ("index", "how-to", "which-method", "reference")
    )
    listed = {
        line
        for tree in re.findall(r"```{toctree}\n(.+?)```", lists, re.DOTALL)
        for line in tree.split("\n")
    }
    assert {page.stem for page in DOCS.glob("*.md")} - listed == {"index"}


def test_options_in_a_text_are_marked(monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "extensions")
    context = {"body": '<a href="#x--y">with --no-align</a>'}
    importlib.import_module("options").join(None, "", "", context, None)
    marked = '<a href="#x--y">with <span class="option">--no-align</span></a>'
    assert context["body"] == marked


def test_each_picture_opens_by_itself_but_a_thumbnail(monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "extensions")
    pictures = importlib.import_module("pictures")
    image, thumbnail = '<img alt="two" src="../_images/a.png" />', '<img alt="" src="b.png" />'
    context = {"body": f"<p>{image}</p>{thumbnail}"}
    pictures.link(None, "", "", context, None)
    assert (
        context["body"]
        == f'<p><a class="picture" href="../_images/a.png">{image}</a></p>{thumbnail}'
    )
