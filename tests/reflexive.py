"""Simulate joints with a stretch reflex."""

from functools import cache

import attrs
from tests.conftest import realizations

import tvsysid as tv

ANKLES = ("plantarflexor", "dorsiflexor", "dorsiflexor_2")


@cache
def reflexive(
    duration, *, stiffness="sine", gain="sine", perturbation="noise", snr_db=10, seed=1000, **reflex
):
    """Ensemble of 2-s realizations and its truth.

    Stiffness is a sine about 100 N·m/rad or constant. The gain is a sine of 8 ± 4 N·m·s/rad,
    on and off, or constant. The torques of both pathways are channels.
    """
    profiles = {"sine": tv.simulate.SineWave(), "constant": tv.simulate.Constant(100.0)}
    gains = {
        "sine": tv.simulate.SineWave(8.0, 4.0, offset=-0.5),
        "square": tv.simulate.SquareWave(0.0, 8.0),
    }
    joint = tv.simulate.ReflexJoint(
        profiles[stiffness],
        reflex_gain=gains.get(gain, gain),
        reflex=tv.simulate.StretchReflex(**reflex),
    )
    kind = tv.simulate.PERTURBATIONS[perturbation]
    simulation = joint.simulate(duration, perturbation=kind, snr_db=snr_db, seed=seed)
    channels = {**simulation.recording.channels, **simulation.pathways}
    recording = attrs.evolve(simulation.recording, channels=channels)
    ensemble = realizations(recording)
    truth = {name: values[0] for name, values in simulation.truth_of(ensemble).items()}
    return ensemble, truth


def centred(ensemble):
    """Ensemble without its mean and that of the torque of each pathway."""
    return tv.preprocess.subtract_mean(ensemble, channels=("intrinsic", "reflex"))
