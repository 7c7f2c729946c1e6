"""Methods that choose their own settings."""

from __future__ import annotations

from dataclasses import dataclass

from tvsysid.errors import InputError
from tvsysid.methods.base import Method
from tvsysid.models import Model
from tvsysid.signals import Ensemble


@dataclass(frozen=True)
class Tuned:
    """A method whose settings are chosen anew from each ensemble that it identifies from.

    What a study needs, in which each trial has data of its own; ``kbr:tuned=true`` on the command line. The model's
    ``method`` tells the settings chosen.

    Parameters
    ----------
    method
        With the settings to begin with.
    seed
        Of :meth:`tvsysid.methods.Method.tuned`.

    Examples
    --------
    >>> from tvsysid.methods import ShortDataSegments
    >>> Tuned(ShortDataSegments()).title
    'Short data segments, tuned'
    """

    method: Method
    seed: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.method, Method):
            raise InputError(f"Tuned: expected one of the package's methods, got {self.method!r}")

    @property
    def key(self) -> str:
        """Of the method."""
        return self.method.key

    @property
    def title(self) -> str:
        """Of the method."""
        return f"{self.method.title}, tuned"

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Of the method."""
        return self.method.assumptions

    def identify(self, ensemble: Ensemble) -> Model:
        """Choose the settings, and identify by them; as :meth:`tvsysid.methods.Method.identify`."""
        return self.method.tuned(ensemble, self.seed).method.identify(ensemble)
