"""One verb for all that has a picture: which figure shows it."""

from __future__ import annotations

from functools import singledispatch
from typing import TYPE_CHECKING, Any

from tvsysid.comparison import Comparison
from tvsysid.errors import InputError
from tvsysid.figures.adaptive import adaptive_impedance
from tvsysid.figures.comparison import OVER_TIME, method_comparison
from tvsysid.figures.diagnosis import diagnosis_panels
from tvsysid.figures.identification import identified_impedance, tuning_curves
from tvsysid.figures.participants import stiffness_of_participants, stiffness_with_bands
from tvsysid.figures.planning import planned_recording
from tvsysid.figures.recorded import ensemble_signals, preparation_steps, recorded_signals
from tvsysid.methods import METHODS, Evidence
from tvsysid.methods.adaptive.model import AdaptiveModel
from tvsysid.models import Model
from tvsysid.planning import Plan
from tvsysid.preprocess import Preparation
from tvsysid.quality import Diagnosis
from tvsysid.signals import Ensemble, Recording
from tvsysid.simulate import Simulation
from tvsysid.study.prepared import excerpt

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure


@singledispatch
def plot(shown: Any, title: str = "") -> Figure:
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
    dims = getattr(shown, "dims", ())
    if "scenario" in dims:
        return _simulations(shown, title)
    if "bootstrap" in dims and shown.sizes["recording"] == 1:
        return stiffness_with_bands(shown, str(shown.recording.values[0]), title)
    if "bootstrap" in dims:
        return stiffness_of_participants(shown, title)
    raise InputError(
        "plot: expected a recording, ensemble, preparation, diagnosis, model, comparison, "
        f"evidence, plan or results of a study, got {type(shown).__name__}"
    )


def _simulations(results: xr.Dataset, title: str) -> Figure:
    import pandas as pd  # noqa: PLC0415  # heavy

    labels = list(map(str, results.scenario.values))
    results = results.sel(quantity=[name for name in results.quantity.values if name in OVER_TIME])
    nothing = pd.DataFrame(
        columns=["scenario", "method", "trials", "metric", "value", "standard_error"]
    )
    shown = labels[len(labels) // 2]
    return method_comparison(results, nothing, [shown], [], title or shown)


def _recording(recording: Recording, title: str = "") -> Figure:
    part = excerpt(recording, "target" if "target" in recording.channels else None)
    whole = len(part) == len(recording)
    return recorded_signals({"" if whole else f"{part.duration:g} s from the middle": part}, title)


def _model(model: Model, title: str = "") -> Figure:
    return identified_impedance({_label(model): model}, {}, title)


def _comparison(comparison: Comparison, title: str = "") -> Figure:
    return identified_impedance(comparison.models, comparison.time_varying_vaf, title)


def _evidence(evidence: Evidence, title: str = "") -> Figure:
    return tuning_curves({evidence.criterion: evidence}, title)


def _label(model: Model) -> str:
    """Return the short name of a model's method."""
    name = model.method.partition("(")[0]
    return next((key for key, method in METHODS.items() if method.__name__ == name), name)


plot.register(Recording, _recording)
plot.register(Simulation, lambda simulation, title="": _recording(simulation.recording, title))
plot.register(Ensemble, ensemble_signals)
plot.register(Preparation, preparation_steps)
plot.register(Diagnosis, diagnosis_panels)
plot.register(Model, _model)
plot.register(AdaptiveModel, adaptive_impedance)
plot.register(Comparison, _comparison)
plot.register(Evidence, _evidence)
plot.register(Plan, planned_recording)
