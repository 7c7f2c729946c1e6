"""
A joint that follows a measured variable
========================================

Nothing repeats, but stiffness depends on a recorded variable: the slow movement. One record is
enough.
"""

import numpy as np
from matplotlib.figure import Figure

import tvsysid as tv

joint = tv.simulate.ScheduledJoint(
    relation=np.polynomial.Polynomial([28.9, 155, 310]),  # N·m/rad, of the variable in rad
    schedule=tv.simulate.SineWave(-0.1, 0.3, period=10.0),  # the variable over time in s
    variation=0.0,
    variable="ankle",
)
simulation = joint.simulate(100, perturbation=tv.simulate.FilteredNoise(), snr_db=15, seed=9)
ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), period=None)

# %%
# ``lpv`` takes stiffness as a polynomial in the variable, with the order that best predicts
# held-out data.

model = tv.ScheduledIRF(variable="ankle").identify(ensemble)
print(model.diagnostics.details["order"])

# %%
# Stiffness over the variable, with its band; the true relation is dashed.

angles = np.linspace(-0.4, 0.2, 61)
found = model.at(angles)["stiffness"]
figure = Figure(figsize=(8, 3.4), layout="constrained")
axes = figure.subplots()
axes.plot(angles, joint.relation(angles), "k--", label="true")
axes.plot(angles, found.values, label="lpv")
axes.fill_between(angles, *found.band(), alpha=0.3, label="95 % band")
axes.set(xlabel="ankle angle (rad)", ylabel="stiffness (N·m/rad)")
axes.legend(loc="upper left")
