"""How systems are simulated, unless a test asks for something else."""

from tvsysid.simulate import FilteredNoise


def simulate(system, duration=10.0, **settings):
    usual = {"perturbation": FilteredNoise(), "snr_db": 10.0, "seed": 1}
    return system.simulate(duration, **(usual | settings))
