"""Publications that the methods come from: citations and BibTeX of ``references.bib``."""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib.resources import files

from tvsysid import __version__

_TEXT = files("tvsysid.methods").joinpath("references.bib").read_text(encoding="utf-8")
REFERENCES = {
    entry[entry.index("{") + 1 : entry.index(",")]: entry.replace("VERSION", __version__)
    for entry in _TEXT.strip().split("\n\n")
}
"""BibTeX entries by key. Pages and DOI are there where they were checked."""


def cited(keys: Iterable[str]) -> str:
    """Return a citation, without brackets.

    Examples
    --------
    >>> cited(["macneil1992", "vanderuit2021"])
    'MacNeil et al., 1992; van de Ruit et al., 2021'
    """
    return "; ".join(_short(REFERENCES[key]) for key in keys)


def bibliography(keys: Iterable[str]) -> str:
    """Return the BibTeX entries of these publications, each once."""
    return "\n\n".join(REFERENCES[key] for key in dict.fromkeys(keys))


def _short(entry: str) -> str:
    """Return authors and year; the entry's ``shorthand``, if it has one."""
    fields: dict[str, str] = dict(re.findall(r"^  (\w+) = \{(.*)\}", entry, re.MULTILINE))
    if "shorthand" in fields:
        return fields["shorthand"]
    names = [author.split(",")[0] for author in fields["author"].split(" and ")]
    return f"{' and '.join(names) if len(names) < 3 else f'{names[0]} et al.'}, {fields['year']}"
