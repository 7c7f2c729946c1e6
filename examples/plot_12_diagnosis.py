"""
What is wrong with a recording?
===============================

A diagnosis looks for 32 faults. Here we add two.
"""

import attrs
import numpy as np

import tvsysid as tv

joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
simulation = joint.simulate(60, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=12)

# %%
# The torque is 4 ms late, as after an unequal filter, and the amplifier clips it at two standard
# deviations.

torque = np.roll(simulation.recording.torque, 4)
recording = attrs.evolve(
    simulation.recording, torque=np.clip(torque, -2 * torque.std(), 2 * torque.std())
)

# %%
# Diagnose at the recorded rate: decimation hides some faults. Each finding says how it changes
# the result, and what to do.

ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))
diagnosis = tv.diagnose(ensemble)
print(diagnosis)

# %%

figure = diagnosis.plot()
