"""
How sure is it?
===============

A band covers measurement noise. A bootstrap over realizations also covers differences between
realizations.
"""

from matplotlib.figure import Figure

import tvsysid as tv

joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
simulation = joint.simulate(60, perturbation=tv.simulate.PRBS(), snr_db=10, seed=10)
recording = tv.preprocess.decimate(simulation.recording, 100)
ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))

# %%
# The pointwise band contains the truth at 95 % of the times. The simultaneous band contains all
# of it in 95 % of experiments. The bootstrap works with any method, your own included.

method = tv.ShortDataSegments()
model = method.identify(ensemble)
estimate = model.estimates["stiffness"]
resampled = tv.uncertainty.bootstrap(method, ensemble, 40, seed=1)
bands = {
    "pointwise": estimate.band(0.95),
    "simultaneous": estimate.band(0.95, simultaneous=True),
    "bootstrap": resampled.estimates["stiffness"].band(0.95),
}
truth = simulation.truth_of(ensemble)["stiffness"][0]
for name, (lower, upper) in bands.items():
    inside = ((lower <= truth) & (truth <= upper)).mean()
    print(
        f"{name}: {(upper - lower).mean() / 2:.1f} N·m/rad to either side, holds "
        f"{100 * inside:.0f} % of the times"
    )

# %%

figure = Figure(figsize=(8, 3.4), layout="constrained")
axes = figure.subplots()
axes.plot(ensemble.time, truth, "k--", label="true")
axes.plot(model.time, model.stiffness, label="sds")
axes.fill_between(model.time, *bands["pointwise"], alpha=0.3, label="95 % at each time")
for edge in bands["simultaneous"]:
    axes.plot(
        model.time,
        edge,
        "C0:",
        label="95 % at all times" if edge is bands["simultaneous"][0] else None,
    )
axes.set(xlabel="time (s)", ylabel="stiffness (N·m/rad)", ylim=(20, 210))
axes.legend(ncols=4, loc="upper center", fontsize="small")
