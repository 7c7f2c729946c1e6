"""What CONTRIBUTING.md, the citation and the workflow say is so."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def read(name):
    return (ROOT / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "CHANGELOG.md", "docs/robustness.md"])
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\((?!http)([^)#]+)", read(page)):
        assert (ROOT / page).parent.joinpath(target).exists(), target


def test_files_that_are_named_exist():
    named = re.findall(r"\b((?:src|tests|benchmarks|docs)/[\w/.-]*\w)", read("CONTRIBUTING.md"))
    assert len(named) > 10
    for name in named:
        assert (ROOT / name).exists(), name


def test_the_version_is_in_one_place():
    assert PROJECT["dynamic"] == ["version"]
    assert "version" not in PROJECT
    assert "version" not in yaml.safe_load(read("CITATION.cff"))


def test_the_paper_is_cited():
    paper = yaml.safe_load(read("CITATION.cff"))["preferred-citation"]
    assert f"*{paper['title']}*" in " ".join(read("README.md").split())
    assert f"{paper['journal']} {paper['volume']}" in read("README.md")


def test_the_workflow_begins_at_the_lowest_python():
    jobs = yaml.safe_load(read(".github/workflows/tests.yml"))["jobs"]
    versions = jobs["tests"]["strategy"]["matrix"]["python"]
    lowest = PROJECT["requires-python"].removeprefix(">=")
    assert versions[0] == lowest
    setup = [
        step["with"]["python-version"]
        for step in jobs["lowest"]["steps"]
        if "setup-python" in step.get("uses", "")
    ]
    assert setup == [lowest]


def test_hooks_need_nothing_from_elsewhere():
    assert {
        place["repo"] for place in yaml.safe_load(read(".pre-commit-config.yaml"))["repos"]
    } == {"local"}
