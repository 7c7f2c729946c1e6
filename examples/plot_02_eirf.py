"""
Each time by itself: eirf
=========================

``eirf`` assumes nothing about how a joint changes. So it needs many realizations.
"""

import tvsysid as tv

joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
simulation = joint.simulate(150, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=2)
recording = tv.preprocess.decimate(simulation.recording, 100)
ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))

# %%
# At each time, an impulse response with lags from -0.12 to 0.12 s is fitted across 75
# realizations: 25 unknowns from 75 equations. Its area is the stiffness. If the joint responds at
# once, shorter lags give a smaller random error.

wide = tv.EnsembleIRF().identify(ensemble)
short = tv.EnsembleIRF(max_lag=0.04).identify(ensemble)
truth = simulation.truth_of(ensemble)["stiffness"][0]
for name, model in (("0.12 s", wide), ("0.04 s", short)):
    print(f"lags of {name}: error {((model.stiffness - truth) ** 2).mean() ** 0.5:.1f} N·m/rad")

# %%
# The switches are as steep as the true ones (dashed), between noisy levels.

figure = short.plot()
figure.axes[0].plot(ensemble.time, truth, "k--")
