"""
Spectra of short segments: esm
==============================

``esm`` gives the frequency response of the joint at each time. Its value at 0 Hz is the stiffness.
"""

import numpy as np
from matplotlib.figure import Figure

import tvsysid as tv
from tvsysid.figures.style import PALETTE, TRUTH

joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
simulation = joint.simulate(100, perturbation=tv.simulate.PRBS(), snr_db=15, seed=5)
recording = tv.preprocess.decimate(simulation.recording, 100)
ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))

# %%
# With ``stiffness="fit"`` the stiffness comes from a second-order fit to the spectra. That has
# less bias than the value at 0 Hz, which suffers from leakage.

model = tv.EnsembleSpectral(stiffness="fit").identify(ensemble)

# %%
# The response where the joint is softest (dashed) and where it is stiffest. The true responses
# are wide and grey.

figure = Figure(figsize=(8, 3.4), layout="constrained")
axes = figure.subplots()
truth = simulation.truth_of(ensemble)["stiffness"][0]
for time, line, colour in ((truth.argmin(), "o--", PALETTE[0]), (truth.argmax(), "s-", PALETTE[1])):
    shown = model.frequencies <= 20
    omega = 2 * np.pi * model.frequencies[shown]
    exact = truth[time] + 2.2j * omega - 0.02 * omega**2
    label = f"{ensemble.time[time]:.2f} s, {truth[time]:.0f} N·m/rad"
    axes.plot(model.frequencies[shown], abs(exact), line[1:], color=TRUTH, linewidth=2.6)
    axes.plot(
        model.frequencies[shown],
        abs(model.frequency_response[time, shown]),
        line,
        color=colour,
        label=label,
    )
axes.set(xlabel="frequency (Hz)", ylabel="gain (N·m/rad)", ylim=(0, None))
axes.legend(loc="upper left")
