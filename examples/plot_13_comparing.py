"""
Compare methods on your data
============================

Several methods identify one ensemble. Where they differ, ask why.
"""

import tvsysid as tv

joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
simulation = joint.simulate(120, perturbation=tv.simulate.PRBS(), snr_db=10, seed=13)
prepared = tv.prepare(simulation.recording, period=2.0, decimate=100)

# %%
# The recommended method, ``adaptive``, comes first. This VAF is of the data that were identified.
# It is no reason to prefer a method with many parameters.

comparison = tv.compare(prepared)
columns = ["stiffness (N·m/rad)", "half_band (N·m/rad)", "VAF (%)"]
print(comparison.summary().set_index("method")[columns].round(1).T.to_string())

# %%

figure = comparison.plot()
