"""
A joint with a reflex
=====================

Methods with one pathway include a stretch reflex in the stiffness. ``cascade`` fits both pathways.
"""

from matplotlib.figure import Figure

import tvsysid as tv

joint = tv.simulate.ReflexJoint(
    stiffness=tv.simulate.SineWave(), reflex_gain=tv.simulate.SineWave(8, 4)
)
simulation = joint.simulate(100, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=7)
prepared = tv.prepare(simulation.recording, period=2.0, decimate=100)
ensemble = prepared.ensemble

# %%
# First see whether there is a reflex.

print(prepared.diagnose())

# %%
# Then separate it. The model has the torque of each pathway, and the reflex gain.

found = tv.compare(prepared, ["cascade", "sds"])
truth = simulation.truth_of(ensemble)
cascade = found.models["cascade"]

figure = Figure(figsize=(9, 3.4), layout="constrained")
stiffness, gain = figure.subplots(1, 2)
for axes, name in ((stiffness, "stiffness"), (gain, "reflex_gain")):
    axes.plot(ensemble.time, truth[name][0], "k--", label="true")
    axes.plot(cascade.time, cascade.estimates[name].values, label="cascade")
    axes.fill_between(cascade.time, *cascade.estimates[name].band(), alpha=0.3)
    axes.set_xlabel("time (s)")
stiffness.plot(ensemble.time, found.models["sds"].stiffness, "-.", label="sds, one pathway")
stiffness.set(ylabel="stiffness (N·m/rad)", ylim=(20, 240))
stiffness.legend(ncols=3, loc="upper center", fontsize="small")
gain.set(ylabel="reflex gain (N·m·s/rad)", ylim=(0, None))
