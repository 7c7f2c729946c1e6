"""Simulation: a recording, the truth about it, and its torque by pathway."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from typing import TYPE_CHECKING, Protocol

import attrs
import numpy as np

from tvsysid.arrays import to_arrays
from tvsysid.errors import InputError
from tvsysid.signals import Array, Ensemble, Recording
from tvsysid.simulate.perturbations import Perturbation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Seed = int | np.random.Generator | np.random.SeedSequence


class System(Protocol):
    """Any object that can be simulated, such as a joint on an actuator."""

    def simulate(
        self,
        duration: float,
        *,
        perturbation: Perturbation,
        snr_db: float,
        seed: Seed,
        rate: float = 1000.0,
    ) -> Simulation:
        """Simulate a recording of ``duration`` s; see :meth:`Joint.simulate`."""
        ...  # pragma: no cover


@attrs.frozen(eq=False, repr=False)
class Simulation:
    """Simulated recording and the truth about it, sample by sample.

    Parameters
    ----------
    recording
        Angle, noisy torque and the channels of the system.
    truth
        Quantities by name, such as ``stiffness`` in N·m/rad, each of shape (time,).
    pathways
        Noiseless torque in N·m by pathway, such as ``intrinsic``, each of shape (time,).
    """

    recording: Recording
    truth: Mapping[str, Array] = attrs.field(converter=to_arrays)
    pathways: Mapping[str, Array] = attrs.field(converter=to_arrays)

    def plot(self, title: str = "") -> Figure:
        """Draw the recording."""
        return self.recording.plot(title)

    def __repr__(self) -> str:
        ranges = {
            name: dict.fromkeys([f"{values.min():g}", f"{values.max():g}"])
            for name, values in self.truth.items()
        }
        truth = ", ".join(f"{name} {' to '.join(ends)}" for name, ends in ranges.items())
        return f"Simulation({self.recording!r}; {truth}; pathways {', '.join(self.pathways)})"

    @property
    def noiseless(self) -> Recording:
        """Same recording with the sum of the pathways as its torque."""
        return attrs.evolve(self.recording, torque=reduce(np.add, self.pathways.values()))

    def truth_of(self, ensemble: Ensemble) -> dict[str, Array]:
        """Return the truth at each sample of an ensemble that was cut from the recording.

        The ensemble may be decimated, trimmed, aligned and selected: samples are found by trial and
        time.

        Returns
        -------
        Quantities by name, shape (realization, time), without context.

        Raises
        ------
        InputError
            For trials or times that the recording does not hold.
        """
        recording, trials = self.recording, ensemble.trials
        start = recording.start + recording.origin - ensemble.origin
        seconds = ensemble.onsets[:, None] + ensemble.time - start
        within = np.rint(seconds * recording.sampling_rate).astype(np.int64)
        lengths = recording.trial_lengths
        first, last = min(trials.min(), within.min()), lengths[trials % len(lengths)] - 1
        if first < 0 or trials.max() >= len(lengths) or (within[:, -1] > last).any():
            raise InputError(
                f"truth_of: {ensemble!r} holds trials or times that {recording!r} does not; give "
                "an ensemble that was cut from this simulation's recording"
            )
        index = np.array(recording.trial_starts)[trials, None] + within
        return {name: values[index] for name, values in self.truth.items()}
