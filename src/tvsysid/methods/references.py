"""Publications that methods come from: the one table from which pages cite, and make BibTeX."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from tvsysid import __version__


class Reference(NamedTuple):
    """A publication: how it is cited in a text, its BibTeX type, and the type's fields."""

    cited: str
    kind: str
    fields: dict[str, str]

    def bibtex(self, key: str) -> str:
        """Entry of a bibliography."""
        lines = "".join(f",\n  {name} = {{{value}}}" for name, value in self.fields.items())
        return f"@{self.kind}{{{key}{lines}\n}}"


def _article(
    cited: str, author: str, title: str, journal: str, volume: str, pages: str = "", doi: str = ""
) -> Reference:
    said = {"author": author, "title": title, "journal": journal, "year": cited[-4:], "volume": volume}
    more = {"pages": pages.replace("-", "--"), "doi": doi}
    return Reference(cited, "article", said | {name: value for name, value in more.items() if value})


TBME = "IEEE Transactions on Biomedical Engineering"
TNSRE = "IEEE Transactions on Neural Systems and Rehabilitation Engineering"
FRONTIERS = "Frontiers in Computational Neuroscience"

REFERENCES: dict[str, Reference] = {
    "tvsysid": Reference(
        "tvsysid",
        "misc",
        {
            "author": "{the tvsysid developers}",
            "title": "tvsysid: time-varying system identification of human joint impedance",
            "note": f"Version {__version__}",
        },
    ),
    "vanderuit2021": _article(
        "van de Ruit et al., 2021",
        "van de Ruit, Mark and Mugge, Winfred and Cavallo, Gaia and Lataire, John and Ludvig, Daniel and Schouten, "
        "Alfred C.",
        "Quantitative comparison of time-varying system identification methods to describe human joint impedance",
        "Annual Reviews in Control",
        "52",
        "91-107",
    ),
    "macneil1992": _article(
        "MacNeil et al., 1992",
        "MacNeil, J. Bart and Kearney, Robert E. and Hunter, Ian W.",
        "Identification of time-varying biological systems from ensemble data",
        TBME,
        "39",
        "1213-1225",
        "10.1109/10.184697",
    ),
    "ludvig2012": _article(
        "Ludvig and Perreault, 2012",
        "Ludvig, Daniel and Perreault, Eric J.",
        "System identification of physiological systems using short data segments",
        TBME,
        "59",
        "3541-3549",
        "10.1109/TBME.2012.2220767",
    ),
    "guarin2017": _article(
        "Guarin and Kearney, 2017",
        "Guarin, Diego L. and Kearney, Robert E.",
        "Estimation of time-varying, intrinsic and reflex dynamic joint stiffness during movement. Application to the "
        "ankle joint",
        FRONTIERS,
        "11",
        "51",
        "10.3389/fncom.2017.00051",
    ),
    "guarin2018": _article(
        "Guarin and Kearney, 2018",
        "Guarin, Diego L. and Kearney, Robert E.",
        "Unbiased estimation of human joint intrinsic mechanical properties during movement",
        TNSRE,
        "26",
        "1975-1984",
        "10.1109/TNSRE.2018.2870330",
    ),
    "lataire2017": _article(
        "Lataire et al., 2017",
        "Lataire, John and Pintelon, Rik and Piga, Dario and T{\\'o}th, Roland",
        "Continuous-time linear time-varying system identification with a frequency-domain kernel-based estimator",
        "IET Control Theory \\& Applications",
        "11",
        "457-465",
        "10.1049/iet-cta.2016.0385",
    ),
    "cavallo2020": Reference(
        "Cavallo et al., 2020",
        "inproceedings",
        {
            "author": "Cavallo, Gaia and Schouten, Alfred C. and Lataire, John",
            "title": "Locally periodic kernel-based regression to identify time-varying ankle impedance during "
            "locomotion: a simulation study",
            "booktitle": "Annual International Conference of the IEEE Engineering in Medicine and Biology Society",
            "year": "2020",
            "pages": "4835--4838",
            "doi": "10.1109/EMBC44109.2020.9175835",
        },
    ),
    "kearney1997": _article(
        "Kearney et al., 1997",
        "Kearney, Robert E. and Stein, Richard B. and Parameswaran, Luckshman",
        "Identification of intrinsic and reflex contributions to human ankle stiffness dynamics",
        TBME,
        "44",
        "493-504",
        "10.1109/10.581944",
    ),
    "ludvig2011": _article(
        "Ludvig et al., 2011",
        "Ludvig, Daniel and Starret Visser, Tanya and Giesbrecht, Heidi and Kearney, Robert E.",
        "Identification of time-varying intrinsic and reflex joint stiffness",
        TBME,
        "58",
        "1715-1723",
        "10.1109/TBME.2011.2113184",
    ),
    "jalaleddini2017": _article(
        "Jalaleddini, Sobhani Tehrani and Kearney, 2017",
        "Jalaleddini, Kian and Sobhani Tehrani, Ehsan and Kearney, Robert E.",
        "A subspace approach to the structural decomposition and identification of ankle joint dynamic stiffness",
        TBME,
        "64",
        "1357-1368",
        "10.1109/TBME.2016.2604293",
    ),
    "jalaleddini2017segments": _article(
        "Jalaleddini, Golkar and Kearney, 2017",
        "Jalaleddini, Kian and Golkar, Mahsa A. and Kearney, Robert E.",
        "Measurement of dynamic joint stiffness from multiple short data segments",
        TNSRE,
        "25",
        "925-934",
        "10.1109/TNSRE.2017.2659749",
    ),
    "sobhani2013": Reference(
        "Sobhani Tehrani et al., 2013",
        "inproceedings",
        {
            "author": "Sobhani Tehrani, Ehsan and Jalaleddini, Kian and Kearney, Robert E.",
            "title": "Linear parameter varying identification of ankle joint intrinsic stiffness during imposed "
            "walking movements",
            "booktitle": "35th Annual International Conference of the IEEE Engineering in Medicine and Biology Society",
            "year": "2013",
            "pages": "4923--4927",
            "doi": "10.1109/EMBC.2013.6610652",
        },
    ),
    "sobhani2015": _article(
        "Sobhani Tehrani et al., 2015",
        "Sobhani Tehrani, Ehsan and Golkar, Mahsa A. and Guarin, Diego L. and Jalaleddini, Kian and Kearney, Robert E.",
        "Methods for the identification of time-varying {H}ammerstein systems with applications to the study of "
        "dynamic joint stiffness",
        "IFAC-PapersOnLine",
        "48",
    ),
    "lataire2012": _article(
        "Lataire et al., 2012",
        "Lataire, John and Pintelon, Rik and Louarroudi, Ebrahim",
        "Non-parametric estimate of the system function of a time-varying system",
        "Automatica",
        "48",
        "666-672",
        "10.1016/j.automatica.2012.01.013",
    ),
    "piovesan2012": _article(
        "Piovesan et al., 2012",
        "Piovesan, Davide and Pierobon, Alberto and DiZio, Paul and Lackner, James R.",
        "Measuring multi-joint stiffness during single movements: numerical validation of a novel time-frequency "
        "approach",
        "PLoS ONE",
        "7",
        "e33086",
        "10.1371/journal.pone.0033086",
    ),
}
"""By key of BibTeX. Pages and DOI are there where they were checked."""


def cited(keys: Iterable[str]) -> str:
    """Citation in brackets; empty without any.

    Examples
    --------
    >>> cited(["macneil1992", "vanderuit2021"])
    '(MacNeil et al., 1992; van de Ruit et al., 2021)'
    """
    texts = "; ".join(REFERENCES[key].cited for key in keys)
    return f"({texts})" if texts else ""


def bibliography(keys: Iterable[str]) -> str:
    """BibTeX of these publications, each once."""
    return "\n\n".join(REFERENCES[key].bibtex(key) for key in dict.fromkeys(keys))
