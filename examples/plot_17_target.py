"""
A person who follows a target
=============================

Nobody follows a target exactly. So realizations are aligned and outliers excluded.
"""

import tvsysid as tv

# %%
# Ten trials of 70 s at 1024 Hz of a virtual participant, with the target torque. Read your own
# file with ``channels={"target": "its name"}``.

simulation = tv.simulate.Participant(1).simulate(perturbation=tv.simulate.FilteredNoise())
print(simulation.recording)

# %%
# Decimate, trim, cut, align to the target, exclude outliers, and subtract the mean. The table has a
# row for each realization.

preparation = tv.preprocess.prepare_experiment(simulation.recording)
table = preparation.table
print(table.excluded_by.replace("", "kept").value_counts().to_string())

# %%
# The picture shows what each step did.

figure = tv.figures.preparation_steps(preparation, "Participant 1, filtered noise")

# %%
# Alignment lowers the stiffness, because the best shift also follows the response to the
# perturbation. So identify the kept realizations once more without their shifts.

unshifted = tv.preprocess.subtract_mean(preparation.recorded.select(preparation.kept))
for name, ensemble in (("aligned", preparation.ensemble), ("as recorded", unshifted)):
    model = tv.ShortDataSegments().identify(ensemble)
    print(f"{name}: {model.stiffness.mean():.0f} N·m/rad on average")
