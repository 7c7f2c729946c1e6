"""One verb for all that has a picture: which figure shows it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from matplotlib import pyplot
from matplotlib.figure import Figure

from tvsysid.comparison import Comparison
from tvsysid.errors import InputError
from tvsysid.figures.diagnosis import diagnosis_panels
from tvsysid.figures.identification import identified_impedance, tuning_curves
from tvsysid.figures.planning import planned_recording
from tvsysid.figures.recorded import ensemble_signals, preparation_steps, recorded_signals
from tvsysid.methods import Evidence
from tvsysid.models import Model
from tvsysid.planning import Plan
from tvsysid.preprocess import Preparation, excerpt
from tvsysid.quality import Diagnosis
from tvsysid.signals import Ensemble, Recording


def plot(shown: Any, title: str = "") -> Figure:
    """Draw an object of the package: a recording, ensemble, model, comparison, plan, ….

    What ``shown.plot()`` draws. Results of a study have functions of their own:
    :func:`method_comparison`, :func:`stiffness_of_participants`, ….

    ``matplotlib.pyplot`` knows the figure, until :func:`save` writes it. A notebook shows it.

    Raises
    ------
    InputError
        For what has no picture.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
    >>> simulation = joint.simulate(20, perturbation=tv.simulate.PRBS(), snr_db=10, seed=1)
    >>> figure = simulation.recording.plot("a simulated joint")
    >>> [axes.get_ylabel() for axes in figure.axes]
    ['angle (rad)', 'torque (N·m)']
    """
    for kind, draw in FIGURES.items():
        if isinstance(shown, kind):
            return pyplot.figure(draw(shown, title))
    raise InputError(f"plot: there is no picture of {type(shown).__name__}")


def _recording(recording: Recording, title: str) -> Figure:
    part = excerpt(recording)
    return recorded_signals({f"{part.duration:g} s of {recording.duration:g} s": part}, title)


def _comparison(found: Comparison, title: str) -> Figure:
    answer = found.answer
    models = {answer.label: answer.model} | dict(found.models)
    return identified_impedance(models, found.time_varying_vaf, title, answer.spread)


FIGURES: dict[type, Callable[[Any, str], Figure]] = {
    Recording: _recording,
    Ensemble: ensemble_signals,
    Preparation: preparation_steps,
    Diagnosis: diagnosis_panels,
    Model: lambda model, title: identified_impedance({model.method: model}, {}, title),
    Comparison: _comparison,
    Evidence: lambda evidence, title: tuning_curves({evidence.criterion: evidence}, title),
    Plan: planned_recording,
}
