"""Several methods on one ensemble: what each found, and how well it explains the torque."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from tvsysid.errors import DataQualityWarning, InputError, describe_error
from tvsysid.estimates import IMPEDANCE
from tvsysid.methods import METHODS, Choice, Evidence, Method, Tuned, apply, label_of, parse, reason_to_skip
from tvsysid.methods.apply import Identifies
from tvsysid.metrics import time_varying_vaf, vaf
from tvsysid.models import Model
from tvsysid.signals import Array, Ensemble, Frozen

if TYPE_CHECKING:
    import pandas as pd

Progress = Callable[[int, int], object]
P = ParamSpec("P")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Frozen):
    """What several methods found in one ensemble; mappings are by the methods' labels.

    ``methods`` have the settings that were used, ``evidence`` is for those that were chosen from the data; ``models``
    are of the methods that could serve the ensemble, ``skipped`` says why the others could not. ``bands`` are lower and
    upper limits of the 95 % bands of estimates over time, by quantity; NaN where there is none. ``vaf`` is the variance
    of the recorded torque accounted for in each realization, in per cent, shape (realization,), ``time_varying_vaf``
    that at each time over realizations, shape (time,).

    Notes
    -----
    The torque is that of the very data that were identified: a method with many parameters has a high VAF even where
    its stiffness is noise.
    """

    ensemble: Ensemble
    methods: Mapping[str, Identifies]
    models: Mapping[str, Model]
    skipped: Mapping[str, str]
    bands: Mapping[str, Mapping[str, tuple[Array, Array]]]
    vaf: Mapping[str, Array]
    time_varying_vaf: Mapping[str, Array]
    evidence: Mapping[str, Evidence]

    def __repr__(self) -> str:
        return f"Comparison({', '.join(self.models) or 'no method'} on {self.ensemble!r})"

    def _repr_html_(self) -> str:
        return str(self.summary().to_html(index=False, na_rep="", float_format="{:.4g}".format))

    def summary(self) -> pd.DataFrame:
        """A row for each method: means over time, extremes of the stiffness with their times, VAF; units in the names.

        ``half_band`` is the mean half width of the stiffness's 95 % band.
        """
        import pandas as pd  # noqa: PLC0415  # heavy

        rows = []
        for label, model in self.models.items():
            stiffness = model.stiffness
            known = np.isfinite(stiffness).any()  # a method may estimate it over another variable than time
            lowest, highest = (int(place(stiffness)) if known else 0 for place in (np.nanargmin, np.nanargmax))
            lower, upper = self.bands[label]["stiffness"]
            rows.append(
                {
                    "method": label,
                    "stiffness (N·m/rad)": _mean(stiffness),
                    "half_band (N·m/rad)": _mean((upper - lower) / 2),
                    "lowest (N·m/rad)": stiffness[lowest],
                    "lowest at (s)": model.time[lowest],
                    "highest (N·m/rad)": stiffness[highest],
                    "highest at (s)": model.time[highest],
                    "viscosity (N·m·s/rad)": _mean(model.viscosity),
                    "inertia (kg·m²)": _mean(model.inertia),
                    "VAF (%)": _mean(self.vaf[label]),
                }
            )
        return pd.DataFrame(rows)

    def over_time(self) -> pd.DataFrame:
        """A row for each method and time: every quantity over time with its 95 % band, and the time-varying VAF."""
        import pandas as pd  # noqa: PLC0415  # heavy

        tables = []
        for label, model in self.models.items():
            columns: dict[str, object] = {"time_s": model.time, "method": label}
            for name, (lower, upper) in self.bands[label].items():
                columns |= {name: model.over_time(name), f"{name}_lower": lower, f"{name}_upper": upper}
            tables.append(pd.DataFrame(columns | {"time_varying_vaf": self.time_varying_vaf[label]}))
        return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def compare(
    ensemble: Ensemble,
    methods: Iterable[str | Identifies] = tuple(METHODS),
    *,
    tune: bool = False,
    progress: Progress | None = None,
) -> Comparison:
    """Identify one ensemble by several methods; what ``tvsysid identify`` does. One that cannot serve it is skipped.

    Parameters
    ----------
    ensemble
        Realizations, mean subtracted.
    methods
        Keys with settings if need be (``"sds:window=0.2"``), ``"module:Class"``, or objects with ``identify``; by
        default the package's own five.
    tune
        Whether each method's settings are chosen from the data first.
    progress
        Called with the number of methods done and of all, before each.

    Raises
    ------
    InputError
        For an unknown method, one that fails, settings that cannot be chosen from data, or if no method can serve the
        ensemble.

    Warns
    -----
    DataQualityWarning
        For what the methods warn of, and for a method that states standard errors but has no band.

    Examples
    --------
    >>> import tvsysid as tv
    >>> simulation = tv.simulate.Joint(stiffness=tv.simulate.SineWave()).simulate(
    ...     40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    >>> ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), period=2.0)
    >>> tv.compare(ensemble, ["sds", "birf"]).summary()[["method", "stiffness (N·m/rad)"]].round(1)
      method  stiffness (N·m/rad)
    0    sds                 ...
    1   birf                 ...
    """
    given: list[str | Identifies] = [methods] if isinstance(methods, str) else list(methods)
    named: dict[str, str | Identifies] = {}
    for item in given:
        if (same := named.setdefault(label_of(item), item)) is not item and same != item:
            raise InputError(
                f"compare: two methods have the name {label_of(item)}; as dataclasses their settings tell them apart"
            )
    if not named:
        raise InputError("compare: expected a method at least, got none")
    chosen = {label: parse(item) if isinstance(item, str) else item for label, item in named.items()}
    models: dict[str, Model] = {}
    skipped: dict[str, str] = {}
    evidence: dict[str, Evidence] = {}
    # Small matrices: BLAS threads would only wait for each other.
    with threadpool_limits(1):
        for number, (label, method) in enumerate(list(chosen.items())):
            if progress is not None:
                progress(number, len(chosen))
            if reason := _guarded(label, reason_to_skip, method, ensemble):
                skipped[label] = reason
                continue
            if tune or isinstance(method, Tuned):
                chosen[label], evidence[label] = _tuned(label, method, ensemble)
            models[label] = _guarded(label, apply, chosen[label], ensemble, label)
        bands = {label: _bands_of(label, model) for label, model in models.items()}
    if not models:
        raise InputError("; ".join(f"{label}: {reason}" for label, reason in skipped.items()))
    torque = ensemble.torque[:, ensemble.core]
    predicted = {label: model.predict(ensemble) for label, model in models.items()}
    return Comparison(
        ensemble,
        chosen,
        models,
        skipped,
        bands,
        {label: vaf(torque, values) for label, values in predicted.items()},
        {label: time_varying_vaf(torque, values) for label, values in predicted.items()},
        evidence,
    )


def _guarded(label: str, verb: Callable[P, Result], *given: P.args, **named: P.kwargs) -> Result:
    """What a verb gives; an error of a plugin names its place in the plugin's code."""
    try:
        return verb(*given, **named)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"method {label}: {describe_error(error)}") from error


def _tuned(label: str, method: Identifies, ensemble: Ensemble) -> Choice[Method]:
    """Method with settings chosen from the data, and the evidence for them."""
    own = method.method if isinstance(method, Tuned) else method
    if not isinstance(own, Method):
        raise InputError(
            f"method {label}: its settings cannot be chosen from data; leave out tune (--tune), and write "
            "key:tuned=true for those methods whose settings can"
        )
    return own.tuned(ensemble)


def _bands_of(label: str, model: Model) -> dict[str, tuple[Array, Array]]:
    """95 % bands of the impedance, and of what else the model estimates over time."""
    error = model.estimates["stiffness"].standard_error if "stiffness" in model.estimates else None
    if error is not None and error.absent:
        warnings.warn(f"{label}: no band: {error.absent}", DataQualityWarning, stacklevel=3)
    bands = {name: (np.full(len(model.time), np.nan),) * 2 for name in IMPEDANCE}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # that there is none
        for name, estimate in model.estimates.items():
            if estimate.axes == ("time",):
                bands[name] = estimate.band()
            elif estimate.axes == ("realization", "time"):
                bands[name] = (np.full(len(model.time), np.nan),) * 2
    return bands


def _mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")
