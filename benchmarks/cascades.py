"""How well pathways that are identified in turn are told apart: python benchmarks/cascades.py [seeds].

Error of the stiffness in N·m/rad (its mean, and RMS over time and seeds) and share of the reflex's noiseless torque
that is explained, in per cent, for joints of two seconds' period moved by filtered noise, at 10 dB.
"""

import sys
import warnings
from dataclasses import dataclass

import numpy as np

import tvsysid as tv

METHODS = ("pc", "pc:nonlinearity=sls", "tvpc", "bpc", "bpc:nonlinearity=polynomial", "bpc:emg=emg,memory=0.3")


@dataclass(frozen=True)
class Earlier:
    """A profile half a second earlier, as a reflex gain from 4 to 12."""

    profile: object
    period: float = 2.0

    def __call__(self, time):
        """In N·m·s/rad."""
        return 8 + 4 * (self.profile(np.asarray(time) + 0.5) - 100) / 50


def tried(profile, gain, duration, seed):
    joint = tv.simulate.ReflexJoint(stiffness=profile, reflex_gain=gain)
    simulation = joint.simulate(duration, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=seed)
    found = simulation.recording
    channels = {**found.channels, **simulation.pathways}
    recording = tv.Recording(found.angle, found.torque, found.sampling_rate, found.start, channels=channels)
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, 100.0), 2.0)
    stiffness = simulation.truth_of(ensemble)["stiffness"][0]
    moving = tuple(name for name, torque in simulation.pathways.items() if torque.any())
    return tv.preprocess.subtract_mean(ensemble, channels=moving), stiffness


def main(seeds):
    warnings.simplefilter("ignore", tv.DataQualityWarning)
    sine, square = tv.simulate.SineWave(), tv.simulate.SquareWave()
    constant = tv.simulate.Constant(100.0)
    cases = {
        "constant, 60 s": (constant, 8.0, 60.0),
        "sine, 40 s": (sine, Earlier(sine), 40.0),
        "sine, 150 s": (sine, Earlier(sine), 150.0),
        "square, 150 s": (square, Earlier(square), 150.0),
        "constant, no reflex, 150 s": (constant, 0.0, 150.0),
    }
    for name, case in cases.items():
        data = [tried(*case, 1000 + seed) for seed in range(seeds)]
        for text in METHODS:
            if text.startswith("pc") and not name.startswith("constant"):
                continue
            errors, shares = [], []
            for ensemble, stiffness in data:
                model = tv.methods.parse(text).identify(ensemble)
                errors.append(model.stiffness - stiffness)
                torque = ensemble.channels["reflex"][:, ensemble.core]
                if torque.any():
                    shares.append(tv.metrics.vaf(torque, model.pathways(ensemble)["reflex"]).mean())
            total = np.sqrt(np.mean(np.square(errors)))
            share = f"{np.mean(shares):.1f} %" if shares else "-"
            print(f"{name:28s}{text:30s}{np.mean(errors):8.2f}{total:8.2f}{share:>9s}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
