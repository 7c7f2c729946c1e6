"""
A compliant actuator
====================

Torque noise also moves the angle of a compliant actuator. Methods then underestimate stiffness.
The disturbance that was applied corrects this.
"""

from matplotlib.figure import Figure

import tvsysid as tv
from tvsysid.figures.style import PALETTE, TRUE_LINE

joint = tv.simulate.CompliantActuator(
    tv.simulate.SineWave(), noise_bandwidth=5.0, disturbance="torque"
)
simulation = joint.simulate(60, perturbation=tv.simulate.FilteredNoise(20.0), snr_db=5, seed=8)
recording = tv.preprocess.decimate(simulation.recording, 100)
ensemble = tv.preprocess.subtract_mean(
    tv.preprocess.segment(recording, period=2.0), ["disturbance"]
)

# %%
# The part of the angle that the recorded disturbance predicts does not depend on the noise.

methods = {
    "angle taken as imposed": tv.KernelRegression(),
    "with a reference": tv.KernelRegression(reference="disturbance", weighting="residual"),
}
figure = Figure(figsize=(8, 3.4), layout="constrained")
axes = figure.subplots()
axes.plot(ensemble.time, simulation.truth_of(ensemble)["stiffness"][0], **TRUE_LINE)
for (name, method), line, colour in zip(methods.items(), ("-.", "-"), PALETTE, strict=False):
    model = method.identify(ensemble)
    print(f"{name}: {model.stiffness.mean():.0f} N·m/rad on average, where 100 is true")
    axes.plot(model.time, model.stiffness, line, color=colour, label=name)
axes.fill_between(model.time, *model.estimates["stiffness"].band(), color=PALETTE[1], alpha=0.3)
axes.set(xlabel="time (s)", ylabel="stiffness (N·m/rad)", ylim=(0, 210))
axes.legend(ncols=3, loc="upper center", fontsize="small")
