"""tvsysid: how stiff a human joint is while it moves.

The way data flows::

    file -> Recording -> preprocess -> Ensemble -> method.identify -> model
    system.simulate -> Simulation(recording, truth)
    model -> stiffness, viscosity, inertia -> metrics, figures

>>> import tvsysid as tv
>>> joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
>>> simulation = joint.simulate(40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
>>> recording = simulation.recording  # or tv.read_recording("ankle.mat", ...)
>>> recording = tv.preprocess.decimate(recording, 100)
>>> ensemble = tv.preprocess.segment(recording, period=2.0)
>>> model = tv.ShortDataSegments(max_lag=0.12, window=0.10).identify(ensemble)
>>> model.stiffness.shape
(200,)
>>> torque = model.predict(ensemble)
>>> vaf = tv.metrics.vaf(ensemble.torque[:, ensemble.core], torque)

Everything is imported when it is first used; ``__init__.pyi`` beside this file lists the public
names.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
