"""
Smooth and nearly periodic: kbr
===============================

In ``kbr`` a kernel is the covariance of stiffness at two times. Few realizations suffice: five.
"""

import tvsysid as tv

joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
simulation = joint.simulate(10, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=6)
recording = tv.preprocess.decimate(simulation.recording, 100)
ensemble = tv.preprocess.segment(recording, period=2.0)

# %%
# The default settings are those of the paper. ``tuned`` finds the most probable settings.

truth = simulation.truth_of(ensemble)["stiffness"][0]
method = tv.KernelRegression()
tuned, evidence = method.tuned(ensemble)
for name, each in (("the paper's settings", method), ("tuned", tuned)):
    model = each.identify(ensemble)
    print(f"{name}: error {((model.stiffness - truth) ** 2).mean() ** 0.5:.1f} N·m/rad")
print(evidence)

# %%
# Ten seconds of data, with the 95 % band; the truth is dashed.

figure = model.plot()
figure.axes[0].plot(ensemble.time, truth, "k--")
