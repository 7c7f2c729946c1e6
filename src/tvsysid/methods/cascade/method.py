"""State what all methods with two pathways have in common."""

from __future__ import annotations

from tvsysid.methods.base import Input, Method
from tvsysid.methods.pathways import PATHWAYS


class TwoPathwayMethod(Method):
    """Identify intrinsic pathway and reflex. In some, a channel of EMG may drive the reflex."""

    emg: str | None = None

    quantities = ("reflex_gain",)
    pathway_names = PATHWAYS

    @property
    def inputs(self) -> tuple[Input, ...]:  # type: ignore[override]
        """Return the channel of the EMG, if it drives the reflex."""
        return () if self.emg is None else (Input(self.emg, "input", "V"),)
