"""
Stiffness without settings
==========================

``adaptive`` finds from the data how fast stiffness changes, and whether and when it switches.
"""

import tvsysid as tv

# %%
# A joint whose stiffness switches between 50 and 150 N·m/rad, perturbed for 40 s: 20 realizations
# of 2 s at 1000 Hz, decimated to 100 Hz. :func:`tvsysid.prepare` also
# reads a file.

joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
simulation = joint.simulate(40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
ensemble = tv.prepare(simulation.recording, period=2.0, decimate=100).ensemble

# %%
# There are no settings. ``switches`` says when stiffness jumps, by how much, and how probable
# that is.

model = tv.AdaptiveRegression().identify(ensemble)
print(model)
for switch in model.switches:
    print(f"{switch.time:.3f} s: {switch.size:+.0f} N·m/rad, probability {switch.probability:.2f}")

# %%
# The band covers noise, and the uncertainty of how fast and when stiffness changes. The truth is
# dashed.

figure = model.plot()
figure.axes[0].plot(ensemble.time, simulation.truth_of(ensemble)["stiffness"][0], "k--")
