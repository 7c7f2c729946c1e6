"""One verb for all that has a picture: which figure shows it."""

from __future__ import annotations

from functools import singledispatch
from typing import TYPE_CHECKING, Any

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
    import pandas as pd  # noqa: PLC0415  # heavy

    dims = getattr(shown, "dims", ())
    if "scenario" in dims:
        labels = list(map(str, shown.scenario.values))
        middle = labels[len(labels) // 2]
        drawn = shown.sel(quantity=[name for name in shown.quantity.values if name in OVER_TIME])
        none = pd.DataFrame(columns=["scenario", "metric", "value"])
        return method_comparison(drawn, none, [middle], [], title or middle)
    if "bootstrap" in dims:
        return stiffness_of_participants(shown, title)
    raise InputError(
        "plot: expected a recording, ensemble, preparation, diagnosis, model, comparison, "
        f"evidence, plan or results of a study, got {type(shown).__name__}"
    )


def _plot_recording(recording: Recording, title: str = "") -> Figure:
    part = excerpt(recording, "target" if "target" in recording.channels else None)
    return recorded_signals({f"{part.duration:g} s of {recording.duration:g} s": part}, title)


plot.register(Recording, _plot_recording)
plot.register(Simulation, lambda simulation, title="": _plot_recording(simulation.recording, title))
plot.register(Ensemble, ensemble_signals)
plot.register(Preparation, preparation_steps)
plot.register(Diagnosis, diagnosis_panels)
plot.register(Model, lambda model, title="": identified_impedance({model.method: model}, {}, title))
plot.register(
    Comparison,
    lambda found, title="": identified_impedance(found.models, found.time_varying_vaf, title),
)
plot.register(
    Evidence, lambda evidence, title="": tuning_curves({evidence.criterion: evidence}, title)
)
plot.register(Plan, planned_recording)
