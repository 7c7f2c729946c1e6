"""Cases of an experiment: recordings, of which each bootstrap is a draw."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError, printable
from tvsysid.methods import label_of
from tvsysid.preprocess import bootstrap_weights
from tvsysid.signals import Array, Ensemble
from tvsysid.study.dataset import AXES, EXPERIMENT, complete, dataset_of
from tvsysid.study.experiment import Analysis, Experiment
from tvsysid.study.measure import TRUTH, Rows, Truth
from tvsysid.study.prepared import Prepared
from tvsysid.study.tasks import Case, Task, digest_of, pickled

if TYPE_CHECKING:
    import xarray as xr

STEPS = {"alignment": "alignment", "task": "task component", "residual": "residual"}
"""Steps that exclude realizations, by the ending of the variable that counts them."""
UNITS = {"target": "N m", "mean": "N m", "alignment": "N m/rad"}
"""Units of variables on the preparation, by the beginnings of their names."""


@attrs.frozen(kw_only=True)
class Resampled(Case):
    """Realizations of a recording, of which some are drawn.

    Parameters
    ----------
    ensemble, data
        All realizations, and their digest.
    pathways
        Noiseless torque of each pathway, if it is known.
    weights
        How often each realization is in each draw, shape (draw, realization).
    realizations, contiguous, seed
        Number of realizations in a draw, whether they follow each other, and random seed.
    """

    ensemble: Ensemble = attrs.field(repr=False)
    data: str
    pathways: Mapping[str, Array] = attrs.field(repr=False)
    weights: NDArray[np.int64] = attrs.field(repr=False)
    realizations: int
    contiguous: bool
    seed: int

    def identity(self, number: int) -> Hashable:
        """Return the weights of the realizations."""
        return bytes(self.weights[number])

    def draw(self, number: int) -> tuple[Ensemble, Truth]:
        """Return the realizations drawn; models are compared with their recorded torque."""
        chosen = np.repeat(np.arange(len(self.ensemble)), self.weights[number])
        drawn = self.ensemble.select(chosen)
        pathways = {name: torque[chosen] for name, torque in self.pathways.items()}
        return drawn, Truth(np.asarray(drawn.torque[:, drawn.core]), pathways=pathways)


def case_of(experiment: Experiment, item: Prepared, analysis: Analysis) -> Resampled:
    """Return the case of a recording and an analysis.

    Raises
    ------
    InputError
        If no realization can be used, or a block is longer than the recording.
    """
    if item.ensemble is None:
        raise InputError(item.failure)
    size, seed = analysis.realizations, experiment.seed_of(item.recorded, analysis.realizations)
    count, contiguous = experiment.bootstraps, analysis.contiguous
    return Resampled(
        label=item.recorded.label,
        ensemble=item.ensemble,
        data=item.digest,
        pathways=item.pathways,
        weights=bootstrap_weights(len(item.ensemble), size, count, seed, contiguous),
        realizations=size,
        contiguous=contiguous,
        seed=seed,
    )


def bootstraps_of(experiment: Experiment, prepared: Sequence[Prepared]) -> tuple[list[Task], Rows]:
    """Return a task for each recording and analysis, and scores of those that cannot be done.

    The last methods take longest and come first.
    """
    if [item.recorded for item in prepared] != list(experiment.recordings):
        given = ", ".join(item.recorded.label for item in prepared)
        raise InputError(
            f"run: the recordings prepared are not the experiment's: {given}; give what "
            "prepared_recordings(experiment) returns"
        )
    tasks: list[Task] = []
    failed: Rows = {}
    draws = range(experiment.bootstraps)
    for column, analysis in reversed(list(enumerate(experiment.analyses))):
        method = experiment.named_methods[analysis.name]
        label, sent = label_of(analysis.method), pickled(f"method {analysis.name}", method)
        for row, item in enumerate(prepared):
            try:
                case = case_of(experiment, item, analysis)
            except InputError as error:
                scores = {"failure": np.array(printable(str(error)))}
                failed |= {(row, draw, column): scores for draw in draws}
                continue
            tasks.append(
                Task(
                    case=case,
                    draws=draws,
                    methods={label: sent},
                    digests={label: digest_of(method)},
                    row=row,
                    columns=(column,),
                )
            )
    return tasks, failed


def results_of_bootstraps(
    experiment: Experiment, prepared: Sequence[Prepared], rows: Rows
) -> xr.Dataset:
    """Return the results of all analyses, and what became of each recording."""
    recordings, analyses = experiment.recordings, experiment.analyses
    known: Rows = {}
    for row, item in enumerate(prepared):
        truth = {"stiffness": np.nan * item.mean_torque} | dict(item.truth)
        known[row,] = {f"{TRUTH}/{name}": values for name, values in truth.items()}
    labels = (
        [each.label for each in recordings],
        range(experiment.bootstraps),
        [each.label for each in analyses],
    )
    coordinates = dict(zip(AXES[1], labels, strict=True))
    preparing = experiment.preparation
    results = dataset_of(coordinates, {**rows, **known}, preparing.period, preparing.rate)
    results = results.sel(statistic="mean", drop=True).transpose("recording", "analysis", ...)
    results = results.assign_coords(
        participant=("recording", [each.participant for each in recordings]),
        perturbation=("recording", [each.perturbation for each in recordings]),
        method_key=("analysis", [each.name for each in analyses]),
        realizations=("analysis", [each.realizations for each in analyses]),
    )
    facts = [_preparation_of(item) for item in prepared]
    for name in facts[0]:
        values = np.array([each[name] for each in facts])
        unit = UNITS.get(name.partition("_")[0])
        dims = ("recording", "time")[: values.ndim]
        results[name] = (dims, values, {"units": unit} if unit else {})
    return complete(results, EXPERIMENT, experiment=experiment.to_json())


def _preparation_of(prepared: Prepared) -> dict[str, Any]:
    """Return what became of a recording, by the names of variables."""
    preparation, ensemble = prepared.preparation, prepared.ensemble
    excluded_by = [] if preparation is None else preparation.table.excluded_by.tolist()
    effects = prepared.alignment._asdict()
    return {
        "recorded": len(excluded_by),
        "survivors": 0 if ensemble is None else len(ensemble),
        **{f"excluded_{name}": excluded_by.count(step) for name, step in STEPS.items()},
        "trials": prepared.trials,
        "trials_left_out": len(prepared.refused),
        "remarks": "\n".join(prepared.remarks),
        "digest": prepared.digest,
        "target_torque": prepared.target_torque,
        "mean_torque": prepared.mean_torque,
        **{f"alignment_{name}": effect for name, effect in effects.items()},
    }
