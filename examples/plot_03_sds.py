"""
A short window: sds
===================

``sds`` assumes a constant joint over a window. A longer window means less noise, but follows a
change less well.
"""

from matplotlib.figure import Figure

import tvsysid as tv

joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
simulation = joint.simulate(60, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=3)
recording = tv.preprocess.decimate(simulation.recording, 100)
ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))

# %%
# A switch takes 80 % of the window to rise. The band covers noise. It does not cover smoothing by
# the window.

figure = Figure(figsize=(8, 3.4), layout="constrained")
axes = figure.subplots()
axes.plot(ensemble.time, simulation.truth_of(ensemble)["stiffness"][0], "k--", label="true")
for window, line in ((0.04, ":"), (0.1, "-"), (0.4, "-.")):
    model = tv.ShortDataSegments(window=window).identify(ensemble)
    axes.plot(model.time, model.stiffness, line, label=f"window {window:g} s")
axes.set(xlabel="time (s)", ylabel="stiffness (N·m/rad)", ylim=(0, 220))
axes.legend(ncols=4, loc="upper center")
