"""What a simulated system gives: a recording, the truth about it, and where its torque comes from."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from typing import Protocol

import attrs
import numpy as np

from tvsysid.checked import Frozen, checked_array
from tvsysid.errors import InputError
from tvsysid.showing import Shown
from tvsysid.signals import Array, Ensemble, Recording
from tvsysid.simulate.perturbations import Perturbation

Seed = int | np.random.Generator | np.random.SeedSequence


class System(Protocol):
    """Whatever can be simulated: a joint, and what it is perturbed with."""

    def simulate(
        self,
        duration: float,
        *,
        perturbation: Perturbation,
        snr_db: float,
        seed: Seed,
        rate: float = 1000.0,
    ) -> Simulation:
        """Record so many seconds; see :meth:`Joint.simulate`."""
        ...  # pragma: no cover


@attrs.frozen(eq=False, repr=False)
class Simulation(Shown, Frozen):
    """A simulated recording and the truth about it, sample by sample.

    The recording has the angle, the noisy torque and the channels of the system; ``truth`` holds
    quantities by name, such as ``stiffness`` in N·m/rad, ``pathways`` the noiseless torque in N·m
    by where it comes from, such as ``intrinsic``; each of shape (time,).

    Raises
    ------
    InputError
        For a quantity or pathway that is not one finite number for each sample of the recording, or
        no pathway.
    """

    recording: Recording
    truth: Mapping[str, Array]
    pathways: Mapping[str, Array]

    def __attrs_post_init__(self) -> None:
        for kind in ("truth", "pathways"):
            checked = {}
            for name, values in getattr(self, kind).items():
                checked[name] = checked_array(f"{kind} {name!r}", values, ("time",))
                if len(checked[name]) != len(self.recording):
                    raise InputError(
                        f"{kind} {name!r}: expected a value for each of the recording's "
                        f"{len(self.recording)} samples, "
                        f"got {len(checked[name])}"
                    )
            object.__setattr__(self, kind, checked)
        if not self.pathways:
            raise InputError(
                "pathways: expected the noiseless torque of one pathway at least, got none"
            )

    def __repr__(self) -> str:
        ranges = {
            name: dict.fromkeys([f"{values.min():g}", f"{values.max():g}"])
            for name, values in self.truth.items()
        }
        truth = ", ".join(f"{name} {' to '.join(ends)}" for name, ends in ranges.items())
        return f"Simulation({self.recording!r}; {truth}; pathways {', '.join(self.pathways)})"

    @property
    def noiseless(self) -> Recording:
        """The same recording with the sum of the pathways as its torque."""
        return attrs.evolve(self.recording, torque=reduce(np.add, self.pathways.values()))

    def truth_of(self, ensemble: Ensemble) -> dict[str, Array]:
        """Truth at each sample of an ensemble that was cut from the recording: (realization, samples), by quantity.

        Samples are found by trial and time, so that the ensemble may be decimated, trimmed, aligned
        and selected; its context is not counted.

        Raises
        ------
        InputError
            For trials or times that the recording does not hold.
        """
        assert ensemble.onsets is not None
        assert ensemble.trials is not None
        recording, trials = self.recording, ensemble.trials
        first = (
            recording.start + recording.origin - ensemble.origin
        )  # time of a trial's first sample
        within = np.rint(
            (ensemble.onsets[:, None] + ensemble.time - first) * recording.sampling_rate
        )
        lengths = np.array([trial.stop - trial.start for trial in recording.trials])
        if not (trials.min() >= 0 and trials.max() < len(lengths)) or not (
            within.min() >= 0 and np.all(within[:, -1] < lengths[trials])
        ):
            raise InputError(
                f"truth_of: {ensemble!r} holds trials or times that {recording!r} does not; "
                "give an ensemble that was cut from this simulation's recording"
            )
        index = np.array(recording.trial_starts)[trials, None] + within.astype(np.int64)
        return {name: values[index] for name, values in self.truth.items()}


def checked_simulation(made: object, system: str) -> Simulation:
    """Return what a system gave, if it is a simulation."""
    if not isinstance(made, Simulation):
        raise InputError(
            f"{system}: simulate must return a tvsysid.simulate.Simulation, got "
            f"{type(made).__name__}"
        )
    return made
