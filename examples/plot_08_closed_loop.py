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
prepared = tv.prepare(simulation.recording, period=2.0, decimate=100)
time, truth = prepared.ensemble.time, simulation.truth_of(prepared.ensemble)["stiffness"][0]

# %%
# The part of the angle that the recorded disturbance predicts does not depend on the noise.

methods = {
    "kbr": "angle taken as imposed",
    "kbr:reference=disturbance,weighting=residual": "with a reference",
}
found = tv.compare(prepared, methods)
figure = Figure(figsize=(8, 3.4), layout="constrained")
axes = figure.subplots()
axes.plot(time, truth, **TRUE_LINE)
for (label, name), line, colour in zip(methods.items(), ("-.", "-"), PALETTE, strict=False):
    model = found.models[label]
    print(f"{name}: {model.stiffness.mean():.0f} N·m/rad on average, where 100 is true")
    axes.plot(model.time, model.stiffness, line, color=colour, label=name)
axes.fill_between(model.time, *model.estimates["stiffness"].band(), color=PALETTE[1], alpha=0.3)
axes.set(xlabel="time (s)", ylabel="stiffness (N·m/rad)", ylim=(0, 210))
axes.legend(ncols=3, loc="upper center", fontsize="small")
