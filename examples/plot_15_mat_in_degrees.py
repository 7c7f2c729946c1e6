"""
A MAT file in degrees, with drift
=================================

A typical recording: degrees, torque of the opposite sign, an offset that drifts, a column for
each trial.
"""

import tempfile
from pathlib import Path

import attrs
import numpy as np
from scipy.io import savemat
from scipy.signal import detrend

import tvsysid as tv

# %%
# First the file: three trials at 1000 Hz, with 15 cycles of 2 s each.

joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
perturbation = tv.simulate.PRBS()
trials = [
    joint.simulate(30, perturbation=perturbation, snr_db=10, seed=seed).recording
    for seed in (1, 2, 3)
]
angle = np.degrees([each.angle for each in trials]).T + 12  # a foot that rests at 12 degrees
torque = -np.array([each.torque for each in trials]).T
drift = np.linspace(0, 6, torque.size).reshape(3, -1).T  # N·m, from the first trial to the last
file = Path(tempfile.mkdtemp()) / "ankle.mat"
savemat(file, {"pos_deg": angle, "tq": torque + drift})
for name, channel in tv.recordings.describe_file(file).items():
    print(name, channel.shape)

# %%
# Say what the file holds: unit, sign, that columns are trials, and that the first cycle begins a
# second after the first sample.

reading = {"angle_unit": "deg", "torque_sign": -1, "columns": "trials", "start": -1.0}
recording = tv.read_recording(file, angle="pos_deg", torque="tq", sampling_rate=1000, **reading)
print(recording)

# %%
# Look for faults.

ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))
print(tv.diagnose(ensemble))

# %%
# The torque drifts. As the finding says, subtract a line from each trial.

trials = recording.torque.reshape(3, -1)
recording = attrs.evolve(recording, torque=detrend(trials).ravel())
ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), period=2.0)
model = tv.AdaptiveRegression().identify(tv.preprocess.subtract_mean(ensemble))

# %%
# The true stiffness is dashed.

figure = model.plot()
figure.axes[0].plot(model.time, tv.simulate.SineWave()(model.time), "k--")
