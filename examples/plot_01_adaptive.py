"""
Stiffness without settings
==========================

``adaptive`` finds from the data how fast stiffness changes, and whether and when it switches.
"""

import matplotlib.pyplot as plt

import tvsysid as tv

# %%
# A joint whose stiffness switches between 50 and 150 N·m/rad, perturbed for 40 s. A recording of yours comes from
# ``tv.read_recording``.

joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
simulation = joint.simulate(40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
recording = tv.preprocess.decimate(simulation.recording, 100)
ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))

# %%
# Nothing is to be chosen.

model = tv.AdaptiveRegression().identify(ensemble)
print(model)

# %%
# The band accounts for how uncertain the speed of change is, and the switches, beside the noise.

lower, upper = model.estimates["stiffness"].band(0.95)
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
axes.plot(ensemble.time, simulation.truth_of(ensemble)["stiffness"][0], color="0.4", linewidth=3, label="true")
axes.plot(model.time, model.stiffness, label="adaptive")
axes.fill_between(model.time, lower, upper, alpha=0.3, label="95 % band")
axes.set(xlabel="time (s)", ylabel="stiffness (N·m/rad)")
axes.legend(ncols=3, loc="upper left")
plt.show()
