"""Prepare files, or a virtual participant, for identification."""

from __future__ import annotations

import glob
import hashlib
import os
import warnings
from collections.abc import Mapping
from pathlib import Path

import attrs
import numpy as np

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods import centered_channels
from tvsysid.numerics.threads import single_thread
from tvsysid.preprocess import Preparation, prepare
from tvsysid.progress import Progress, no_progress
from tvsysid.recordings import read_usable_trials
from tvsysid.signals import Array, Ensemble, Recording
from tvsysid.simulate import PERTURBATIONS, Participant, Simulation
from tvsysid.study.alignment import UNKNOWN, AlignmentEffect, effect_of_alignment
from tvsysid.study.experiment import Experiment, Recorded

EXCERPT_S = 10.0  # duration of the part of a recording that is drawn
TORQUE, PATHWAY = "tvsysid: recorded torque", "tvsysid: pathway "
"""Channels that pass through the preparation: torque before its mean is lost, and pathways."""


@attrs.frozen(eq=False, kw_only=True)
class Prepared:
    """One recording, ready for identification.

    Parameters
    ----------
    recorded
        The participant and perturbation.
    preparation, excerpt
        What was done to the recording, and ten seconds of it; None if nothing could be prepared.
    ensemble
        Kept realizations, mean subtracted, with the channels that methods need; None if there are
        none.
    reference
        Channel that a method takes as the applied disturbance, if any.
    target_torque, mean_torque
        Target, and mean torque of the kept realizations, in N·m, shape (time,); NaN if unknown.
    truth
        Quantities of a simulation: means over the kept realizations, shape (time,).
    pathways
        Noiseless torques of a simulation, mean subtracted, shape (realization, time).
    trials
        Number of usable trials.
    refused
        Why other trials cannot be used, by file.
    warnings, failure
        Doubts, and why nothing could be prepared.
    alignment
        Effect of the shifts on stiffness.
    """

    recorded: Recorded
    preparation: Preparation | None = None
    excerpt: Recording | None = None
    ensemble: Ensemble | None = None
    reference: str | None = None
    target_torque: Array
    mean_torque: Array
    truth: Mapping[str, Array] = attrs.field(factory=dict)
    pathways: Mapping[str, Array] = attrs.field(factory=dict)
    trials: int = 0
    refused: Mapping[str, str] = attrs.field(factory=dict)
    warnings: tuple[str, ...] = ()
    failure: str = ""
    alignment: AlignmentEffect = UNKNOWN

    @property
    def remarks(self) -> tuple[str, ...]:
        """Trials that are left out, doubts and failure, in words."""
        left_out = (f"{name} is left out: {reason}" for name, reason in self.refused.items())
        return (*left_out, *self.warnings, *([self.failure] if self.failure else []))

    @property
    def digest(self) -> str:
        """Hash of the ensemble; empty if there is none."""
        if self.ensemble is None:
            return ""
        digest = hashlib.sha256()
        for name, value in attrs.asdict(self.ensemble, recurse=False).items():
            for key, item in value.items() if isinstance(value, Mapping) else [(name, value)]:
                is_array = isinstance(item, np.ndarray)
                digest.update(f"{key} {item.shape if is_array else item}".encode())
                digest.update(item.tobytes() if is_array else b"")
        return digest.hexdigest()[:16]


def prepared_recordings(
    experiment: Experiment, progress: Progress = no_progress
) -> tuple[Prepared, ...]:
    """Prepare every recording of an experiment. One that cannot be used does not stop the others.

    Parameters
    ----------
    progress
        Called with the numbers of finished recordings and of all.
    """
    prepared: list[Prepared] = []
    for recorded in experiment.recordings:
        progress(len(prepared), len(experiment.recordings))
        with single_thread():  # so that the same recordings have the same digest everywhere
            prepared.append(_prepare(experiment, recorded))
    return tuple(prepared)


def _prepare(experiment: Experiment, recorded: Recorded) -> Prepared:
    preparing = experiment.preparation
    unknown = np.full(round(preparing.period * preparing.rate), np.nan)
    prepared = Prepared(recorded=recorded, target_torque=unknown, mean_torque=unknown)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            simulation = None
            if recorded.is_virtual:
                perturbation = PERTURBATIONS[recorded.perturbation]
                simulation = Participant(recorded.number).simulate(perturbation=perturbation)
            recording, refused = _read(experiment, recorded, simulation)
            prepared = attrs.evolve(prepared, trials=len(recording.trials), refused=refused)
            prepared = _with_ensemble(prepared, experiment, recording, simulation)
        except (InputError, MemoryError) as error:
            failure = str(error) or "there is not enough memory"
            prepared = attrs.evolve(prepared, failure=failure)
    texts = dict.fromkeys(str(item.message) for item in caught)
    return attrs.evolve(prepared, warnings=tuple(texts))


def _with_ensemble(
    prepared: Prepared,
    experiment: Experiment,
    recording: Recording,
    simulation: Simulation | None,
) -> Prepared:
    """Return a recording with its kept realizations, and what is known of them."""
    preparing, methods = experiment.preparation, experiment.named_methods.values()
    centered = sorted(set(centered_channels(methods)) & set(recording.channels))
    preparation = prepare(recording, **attrs.asdict(preparing), channels=centered)
    ensemble, inputs = preparation.ensemble, [each for method in methods for each in method.inputs]
    cores = {name: values[:, ensemble.core] for name, values in ensemble.channels.items()}
    needed = ensemble.channels.keys() & {each.name for each in inputs}
    references = needed & {each.name for each in inputs if each.kind == "reference"}
    is_rectified = any(method.uses_recorded_angle for method in methods)
    most = max(analysis.realizations for analysis in experiment.analyses)
    if most > len(ensemble):
        warnings.warn(
            f"{most} realizations are drawn from {len(ensemble)}: they vary less than so many "
            f"recorded ones would; draw {len(ensemble)} at most",
            DataQualityWarning,
            stacklevel=2,
        )
    truth = {} if simulation is None else simulation.truth_of(ensemble)
    target = cores.get(preparing.reference or "")
    return attrs.evolve(
        prepared,
        preparation=preparation,
        excerpt=excerpt(recording, preparing.reference),
        ensemble=attrs.evolve(
            ensemble,
            channels={name: ensemble.channels[name] for name in sorted(needed)},
            recorded_angle=ensemble.recorded_angle if is_rectified else None,
        ),
        reference=min(references, default=None),
        target_torque=prepared.target_torque if target is None else target.mean(axis=0),
        mean_torque=cores[TORQUE].mean(axis=0),
        truth={name: values.mean(axis=0) for name, values in truth.items()},
        pathways={
            name.removeprefix(PATHWAY): torque - torque.mean(axis=0)
            for name, torque in cores.items()
            if name.startswith(PATHWAY)
        },
        alignment=effect_of_alignment(preparation),
    )


def _read(
    experiment: Experiment, recorded: Recorded, simulation: Simulation | None
) -> tuple[Recording, dict[str, str]]:
    """Return all usable trials as one recording, and why others cannot be used.

    Raises an InputError if there is none.
    """
    refused: dict[str, str] = {}
    if simulation is not None:
        recording = simulation.recording
        methods = experiment.named_methods.values()
        several = any(len(method.pathway_names) > 1 for method in methods)
        pathways = simulation.pathways if several else {}
    else:
        assert experiment.reading is not None
        preparing, reference = experiment.preparation, experiment.preparation.reference
        files, refused = _files(experiment.folder, recorded.files)
        target = {} if reference is None else {reference: reference}
        channels = target | dict(experiment.reading.channels)
        reading = attrs.evolve(experiment.reading, channels=channels)
        usable = read_usable_trials(files, reading, 2 * preparing.ends + preparing.period)
        refused |= usable.refused
        if usable.recording is None:
            reasons = "; ".join(f"{name}: {reason}" for name, reason in refused.items())
            raise InputError(f"no trial can be used: {reasons}")
        recording, pathways = usable.recording, {}
    further = {TORQUE: recording.torque} | {PATHWAY + name: pathways[name] for name in pathways}
    return attrs.evolve(recording, channels={**recording.channels, **further}), refused


def _files(folder: Path, patterns: tuple[str, ...]) -> tuple[dict[str, Path], dict[str, str]]:
    """Return the files that match patterns, each once, by name, and the patterns without a match.

    Files are called by their place in the folder, which may be moved with all that is in it.
    """
    files: dict[Path, str] = {}
    missing = {}
    for pattern in map(os.path.expanduser, patterns):
        if not glob.has_magic(pattern) or (folder / pattern).is_file():
            found = [pattern]
        else:
            root = None if Path(pattern).is_absolute() else folder
            found = sorted(glob.glob(pattern, root_dir=root, recursive=True))
        if not found:
            missing[pattern] = (
                "no file has such a name, in the folder of the study or where the name says"
            )
        for name in found:
            files.setdefault((folder / name).resolve(), name)
    return {name: folder / name for name in files.values()}, missing


def excerpt(recording: Recording, reference: str | None) -> Recording:
    """Return ten seconds from the middle of the first trial, with the target torque."""
    trial = recording.trials[0]
    count = min(round(EXCERPT_S * recording.sampling_rate), trial.stop - trial.start)
    first = trial.start + (trial.stop - trial.start - count) // 2
    part = slice(first, first + count)
    target = {} if reference is None else {"target": recording.channels[reference][part]}
    return Recording(
        recording.angle[part], recording.torque[part], recording.sampling_rate, channels=target
    )
