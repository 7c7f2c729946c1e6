"""
A method of your own
====================

A method is a subclass of ``tv.Method`` with ``fit(ensemble)``. It runs on the same data as the
others.
"""

import attrs
import numpy as np

import tvsysid as tv

# %%
# Inertia, viscosity and stiffness are constant over a sliding window.


@attrs.frozen
class SlidingFit(tv.Method):
    """Least squares in a window that slides over time."""

    window: float = 0.10  # s

    def fit(self, ensemble):
        """Fit second-order dynamics around each time."""
        signals, torque = ensemble.derivatives(), ensemble.torque[:, ensemble.core]
        half = round(self.window / 2 * ensemble.sampling_rate)
        impedance = np.full((3, ensemble.samples), np.nan)
        for now in range(ensemble.samples):
            near = slice(max(0, now - half), now + half + 1)
            inputs = signals[:, :, near].reshape(3, -1)
            impedance[:, now] = np.linalg.lstsq(inputs.T, torque[:, near].ravel(), rcond=None)[0]
        return tv.Model.of(ensemble, *impedance)


# %%

joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
simulation = joint.simulate(60, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=14)
recording = tv.preprocess.decimate(simulation.recording, 100)
ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))

comparison = tv.compare(ensemble, [SlidingFit(), "sds"])
truth = simulation.truth_of(ensemble)["stiffness"][0]
for label, model in comparison.models.items():
    print(f"{label}: error {((model.stiffness - truth) ** 2).mean() ** 0.5:.1f} N·m/rad")

# %%
# :func:`tvsysid.check_method` then checks it.

figure = comparison.plot()
