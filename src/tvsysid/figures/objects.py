"""One verb for all that has a picture: which figure shows it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from tvsysid.comparison import Comparison
from tvsysid.errors import InputError
from tvsysid.figures.diagnosis import diagnosis_panels
from tvsysid.figures.identification import identified_impedance, tuning_curves
from tvsysid.figures.participants import stiffness_of_participants
from tvsysid.figures.planning import planned_recording
from tvsysid.figures.recorded import ensemble_signals, preparation_steps, recorded_signals
from tvsysid.figures.simulations import OVER_TIME, method_comparison
from tvsysid.methods import Evidence
from tvsysid.models import Model
from tvsysid.planning import Plan
from tvsysid.preprocess import Preparation
from tvsysid.quality import Diagnosis
from tvsysid.signals import Ensemble, Recording
from tvsysid.simulate import Simulation
from tvsysid.study.prepared import excerpt

if TYPE_CHECKING:
    import xarray as xr


def plot(shown: Any, title: str = "") -> Figure:  # noqa: PLR0911  # one for each kind
    """Draw an object of the package: a recording, ensemble, model, comparison, study results, ….

    What ``shown.plot()`` draws. Results, as of :func:`tvsysid.study.run`, are an
    ``xarray.Dataset``, which has another ``plot`` of its own: of a simulation study, estimates over
    time of the scenario in the middle; of an experiment, stiffness of all participants. The
    functions of :mod:`tvsysid.figures` that draw these take more to choose from.

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
    match shown:
        case Recording():
            return _plot_recording(shown, title)
        case Simulation():
            return _plot_recording(shown.recording, title)
        case Ensemble():
            return ensemble_signals(shown, title)
        case Preparation():
            return preparation_steps(shown, title)
        case Diagnosis():
            return diagnosis_panels(shown, title)
        case Model():
            return identified_impedance({shown.method: shown}, {}, title)
        case Comparison():
            answer = shown.answer
            models = {answer.label: answer.model} | dict(shown.models)
            vaf = shown.time_varying_vaf
            return identified_impedance(models, vaf, title, spread=answer.spread)
        case Evidence():
            return tuning_curves({shown.criterion: shown}, title)
        case Plan():
            return planned_recording(shown, title)
    dims = getattr(shown, "dims", ())
    if "scenario" in dims:
        return _plot_simulations(shown, title)
    if "bootstrap" in dims:
        return stiffness_of_participants(shown, title)
    raise InputError(
        "plot: expected a recording, ensemble, preparation, diagnosis, model, comparison, "
        f"evidence, plan or results of a study, got {type(shown).__name__}"
    )


def _plot_recording(recording: Recording, title: str) -> Figure:
    part = excerpt(recording)
    return recorded_signals({f"{part.duration:g} s of {recording.duration:g} s": part}, title)


def _plot_simulations(results: xr.Dataset, title: str) -> Figure:
    import pandas as pd  # noqa: PLC0415  # heavy

    middle = str(results.scenario.values[results.sizes["scenario"] // 2])
    quantities = [name for name in results.quantity.values if name in OVER_TIME]
    nothing = pd.DataFrame(columns=["scenario", "metric", "value"])
    drawn = results.sel(quantity=quantities)
    return method_comparison(drawn, nothing, [middle], [], title or middle)
