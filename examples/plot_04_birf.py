"""
A few basis functions: birf
===========================

``birf`` takes stiffness as a sum of basis functions of time. If they suit the movement, few data
are enough.
"""

from matplotlib.figure import Figure

import tvsysid as tv

joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
simulation = joint.simulate(40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=4)
recording = tv.preprocess.decimate(simulation.recording, 100)
ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))

# %%
# Ten B-splines are the default. A Fourier series suits a movement that repeats without a pause.
# Sparse regression sets unnecessary coefficients to zero.

bases = {"10 B-splines": tv.CubicBSplines(10), "Fourier series": tv.FourierSeries(9)}
truth = simulation.truth_of(ensemble)["stiffness"][0]

figure = Figure(figsize=(8, 3.4), layout="constrained")
axes = figure.subplots()
axes.plot(ensemble.time, truth, "k--", label="true")
for (name, basis), line in zip(bases.items(), ("-", "-."), strict=True):
    model = tv.BasisIRF(basis=basis).identify(ensemble)
    print(f"{name}: error {((model.stiffness - truth) ** 2).mean() ** 0.5:.1f} N·m/rad")
    axes.plot(model.time, model.stiffness, line, label=name)
axes.set(xlabel="time (s)", ylabel="stiffness (N·m/rad)", ylim=(30, 190))
axes.legend(ncols=3, loc="upper center")
