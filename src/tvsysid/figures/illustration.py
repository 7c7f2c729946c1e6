"""A figure and what it shows in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Illustration:
    """A figure with what it shows in words.

    Parameters
    ----------
    figure
        To save with :func:`tvsysid.figures.save`.
    title
        A heading.
    description
        Full sentences that stand for the picture where it cannot be seen.
    """

    figure: Figure
    title: str
    description: str
