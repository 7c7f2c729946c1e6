"""
Settings from the data
======================

A basis or a kernel can be far too coarse, and the estimate does not show it. ``birf`` and ``kbr``
can choose their settings from the data.
"""

import tvsysid as tv

joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
simulation = joint.simulate(80, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=11)
recording = tv.preprocess.decimate(simulation.recording, 100)
ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))

# %%
# ``tuned`` returns a method of the same class, and the evidence for its settings.

method = tv.BasisIRF()
tuned, evidence = method.tuned(ensemble)
print(evidence)

truth = simulation.truth_of(ensemble)["stiffness"][0]
for name, each in (("before", method), ("after", tuned)):
    error = ((each.identify(ensemble).stiffness - truth) ** 2).mean() ** 0.5
    print(f"{name}: error {error:.1f} N·m/rad")

# %%
# The settings that were tried, with the score of each.

figure = evidence.plot()
