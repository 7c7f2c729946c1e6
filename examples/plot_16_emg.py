"""
A reflex, with EMG
==================

A typical recording: a slow voluntary torque, a stretch reflex, and EMG of the stretched muscle in
mV.
"""

import attrs
import numpy as np
from matplotlib.figure import Figure

import tvsysid as tv

# %%
# 100 s at 1000 Hz of a joint whose reflex varies over the cycle, with slow noise like that of a
# voluntary torque.

joint = tv.simulate.ReflexJoint(
    stiffness=tv.simulate.SineWave(), reflex_gain=tv.simulate.SineWave(10, 5), noise_bandwidth=1.0
)
simulation = joint.simulate(100, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=16)
emg = 0.02 * simulation.recording.channels["emg"]  # mV
recording = attrs.evolve(simulation.recording, channels={"EMG_SOL": emg})

# %%
# ``cascade`` predicts the reflex from the stretch or from EMG. EMG is noisy: if the stretch
# predicts the reflex, as here, it is the better input.

prepared = tv.prepare(recording, period=2.0, decimate=100)
ensemble = prepared.ensemble
comparison = tv.compare(prepared, ["cascade", "cascade:emg=EMG_SOL"])
truth = simulation.truth_of(ensemble)
for label, model in comparison.models.items():
    error = np.sqrt(np.mean((model.stiffness - truth["stiffness"][0]) ** 2))
    print(f"{label}: stiffness {model.stiffness.mean():.0f} N·m/rad, error {error:.1f}")

# %%
# The share of the torque of each pathway over time.

figure = Figure(figsize=(8, 3.4), layout="constrained")
axes = figure.subplots()
for (name, torque), line in zip(
    comparison.models["cascade"].pathways(ensemble).items(), ("-", "-."), strict=True
):
    axes.plot(ensemble.time, torque.std(axis=0), line, label=name)
axes.set(xlabel="time (s)", ylabel="torque (N·m, standard deviation)", ylim=(0, None))
axes.legend()
