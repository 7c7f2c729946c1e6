"""Identify one ensemble by several methods, and compare what they find."""

from __future__ import annotations

import html
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from tvsysid.comparison.held_out import held_out_vaf
from tvsysid.errors import DataQualityWarning, InputError, describe_error
from tvsysid.methods import DEFAULT_METHODS, Evidence, Method, Tuned, label_of, parse
from tvsysid.methods.adaptive.model import AdaptiveModel
from tvsysid.methods.base import SkippedError
from tvsysid.metrics import time_varying_vaf, vaf
from tvsysid.models import IMPEDANCE, Estimate, Model
from tvsysid.numerics.bands import mean_of
from tvsysid.numerics.threads import single_thread
from tvsysid.progress import Progress, no_progress
from tvsysid.quality import Diagnosis
from tvsysid.recommendation import Recommendation, Trust, recommend, trust_in
from tvsysid.signals import Array, Ensemble

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

FOLDS = 5
OVER_TIME = {("time",), ("realization", "time")}  # axes of estimates that have a value at each time


@attrs.frozen(eq=False, repr=False)
class Comparison:
    """Results of several methods on one ensemble, by the methods' labels.

    Parameters
    ----------
    ensemble
        Ensemble that was identified.
    methods
        All methods, with the settings that were used.
    models
        Models of the methods that succeeded.
    predicted
        Torque that each model predicts in N·m, shape (realization, time).
    evidence
        Reasons for settings that were chosen from the data.
    skipped, failed
        Why a method cannot serve the ensemble, and why one failed.
    """

    ensemble: Ensemble
    methods: Mapping[str, Method]
    models: Mapping[str, Model]
    predicted: Mapping[str, Array]
    evidence: Mapping[str, Evidence]
    skipped: Mapping[str, str]
    failed: Mapping[str, str]

    @cached_property
    def bands(self) -> dict[str, dict[str, Array]]:
        """95 % bands by label and quantity: lower and upper limit, shape (2, time).

        NaN where there is none.
        """
        return {label: _bands(model) for label, model in self.models.items()}

    @cached_property
    def vaf(self) -> dict[str, Array]:
        """Variance accounted for in each realization in %, by label, shape (realization,).

        The torque is that of the data that were identified. A method with many parameters has a
        high VAF even where its stiffness is noise: see :meth:`held_out_vaf`.
        """
        torque = self.ensemble.torque[:, self.ensemble.core]
        return {label: vaf(torque, values) for label, values in self.predicted.items()}

    @cached_property
    def time_varying_vaf(self) -> dict[str, Array]:
        """Variance accounted for at each time over realizations in %, by label, shape (time,)."""
        torque = self.ensemble.torque[:, self.ensemble.core]
        return {label: time_varying_vaf(torque, each) for label, each in self.predicted.items()}

    def vaf_over_time(self) -> dict[str, Array]:
        """Return ``time_varying_vaf`` for figures. A single realization has none."""
        return self.time_varying_vaf if len(self.ensemble) > 1 else {}

    @cached_property
    def recommendation(self) -> Recommendation:
        """Recommended method for the ensemble, given the channels that the methods use."""
        inputs = {
            item.kind: item.name for label in self.models for item in self.methods[label].inputs
        }
        return recommend(
            self.ensemble,
            inputs.get("reference"),
            inputs.get("scheduling"),
            model=self.models[self._default],
        )

    @cached_property
    def suited(self) -> list[str]:
        """Labels of the methods that suit the data, the best first."""
        methods = {label: self.methods[label] for label in self.models}
        return self.recommendation.select(methods, self.evidence)

    @property
    def leading(self) -> str:
        """Label of the recommended method; if that was not used, of ``adaptive`` or the first."""
        return next(iter(self.suited if len(self.models) > 1 else []), self._default)

    @property
    def is_suited(self) -> bool:
        """Whether the ``leading`` method suits the data."""
        return self.leading in self.suited

    @property
    def _default(self) -> str:
        """Label of ``adaptive``, or of the first method."""
        adaptive = (label for label, each in self.models.items() if isinstance(each, AdaptiveModel))
        return next(adaptive, next(iter(self.models)))

    def trust(
        self,
        diagnosis: Diagnosis | None = None,
        held_out_vaf: float = math.nan,
        unnamed_references: Sequence[str] = (),
    ) -> Trust:
        """Judge how far the stiffness of the ``leading`` method can be trusted.

        Parameters
        ----------
        diagnosis
            Diagnosis of the data, if there is a better one than that of ``recommendation``.
        held_out_vaf
            Typical VAF of held-out realizations in %, by the leading method.
        unnamed_references
            A sentence for each channel outside the ensemble that moves the angle.
        """
        best, label = self.recommendation, self.leading
        best = attrs.evolve(
            best,
            diagnosis=diagnosis or best.diagnosis,
            unnamed_references=(*unnamed_references, *best.unnamed_references),
        )
        return trust_in(self.models[label], self.methods[label], best, self.is_suited, held_out_vaf)

    def __repr__(self) -> str:
        failed = f"; failed: {', '.join(self.failed)}" if self.failed else ""
        return f"Comparison({', '.join(self.models)} on {self.ensemble!r}{failed})"

    def plot(self, title: str = "") -> Figure:
        """Draw the estimates of all methods."""
        from tvsysid.figures import plot  # noqa: PLC0415  # figures stand above

        return plot(self, title)

    def _repr_html_(self) -> str:
        trust = self.trust()
        notes = [f"No stiffness is stated. {' '.join(trust.reasons)}"] * (trust.level == "none")
        notes += [f"{label}: {why}" for label, why in {**self.skipped, **self.failed}.items()]
        text = "".join(f"<p>{html.escape(line)}</p>" for line in (repr(self), *notes))
        return text + self.summary().to_html(index=False)

    def summary(self) -> pd.DataFrame:
        """Return a table with a row for each method.

        It has means over time, extremes of the stiffness with their times, and the VAF. Units are
        in the names. ``half_band`` is the mean half width of the stiffness's 95 % band.
        """
        return _table(self.rows())

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows of :meth:`summary`."""
        rows = []
        for label, model in self.models.items():
            stiffness, (lower, upper) = model.stiffness, self.bands[label]["stiffness"]
            lowest = np.argmin(np.nan_to_num(stiffness, nan=np.inf))
            highest = np.argmax(np.nan_to_num(stiffness, nan=-np.inf))
            rows.append(
                {
                    "method": label,
                    "stiffness (N·m/rad)": mean_of(stiffness),
                    "half_band (N·m/rad)": mean_of((upper - lower) / 2),
                    "lowest (N·m/rad)": stiffness[lowest],
                    "lowest at (s)": model.time[lowest],
                    "highest (N·m/rad)": stiffness[highest],
                    "highest at (s)": model.time[highest],
                    "viscosity (N·m·s/rad)": mean_of(model.viscosity),
                    "inertia (kg·m²)": mean_of(model.inertia),
                    "VAF (%)": mean_of(self.vaf[label]),
                }
            )
        return rows

    def over_time(self) -> pd.DataFrame:
        """Return a table with a row for each method and time.

        It has every quantity over time with its 95 % band, and the time-varying VAF.
        """
        return _table(self.rows_over_time())

    def rows_over_time(self) -> list[dict[str, Any]]:
        """Return the rows of :meth:`over_time`."""
        rows: list[dict[str, Any]] = []
        for label, model in self.models.items():
            columns = {"time_s": model.time, "method": [label] * len(model.time)}
            for name, (lower, upper) in self.bands[label].items():
                columns[name] = model.over_time(name)
                columns |= {f"{name}_lower": lower, f"{name}_upper": upper}
            columns["time_varying_vaf"] = self.time_varying_vaf[label]
            rows += [
                dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)
            ]
        return rows

    def over_variables(self) -> pd.DataFrame:
        """Return a table with a row for each method, quantity and value of a measured variable.

        It has the estimates over such variables with their 95 % bands.
        """
        return _table(self.rows_over_variables())

    def rows_over_variables(self) -> list[dict[str, Any]]:
        """Return the rows of :meth:`over_variables`."""
        return [
            {
                "method": label,
                "variable": variable,
                "value": value,
                "quantity": name,
                "unit": estimate.unit,
                "estimate": each,
                "lower": lower,
                "upper": upper,
            }
            for label, model in self.models.items()
            for name, estimate in model.estimates.items()
            for variable in estimate.axes
            if len(estimate.axes) == 1 and variable in model.coordinates
            for value, each, lower, upper in zip(
                model.coordinates[variable], estimate.values, *_band(estimate), strict=True
            )
        ]

    def held_out_vaf(
        self, folds: int = FOLDS, *, jobs: int = 1, progress: Progress = no_progress
    ) -> dict[str, Array]:
        r"""Return the VAF of realizations that were held out in %, by label, shape (realization,).

        Realizations are dealt, in the order of the record, into folds of consecutive ones. Slow
        changes so count as they would in a new experiment. Each method, with its settings in
        ``methods``, is identified from all folds but one, and predicts the torque of that one:

        .. math:: \hat y_r(t) = \bar y(t) + \hat m(\theta_r - \bar\theta)(t) - \overline{\hat m}(t)

        Where the ensemble's mean was subtracted, the means (bars) are those of the realizations
        kept, subtracted anew from all: a prediction uses nothing of the realization's torque. The
        VAF is that of the deviation from that mean, :func:`tvsysid.metrics.vaf` of :math:`y_r -
        \bar y` and :math:`\hat y_r - \bar y`.

        Parameters
        ----------
        folds
            Number of folds, at least two; at most one for each realization. Each method is
            identified as many times.
        jobs
            Number of processes that identify folds; -1 for one per core. They are copies of this
            process, which only Linux makes safely: elsewhere folds are identified in turn. Use 1
            if this process has threads of its own.
        progress
            As of :func:`compare`.

        Returns
        -------
        dict
            NaN where a method cannot identify without the fold, for a single realization, and for
            two whose mean was subtracted.

        Raises
        ------
        InputError
            For fewer than two folds.

        Warns
        -----
        DataQualityWarning
            If a method cannot identify the realizations kept; says why.

        Notes
        -----
        Samples of context that belong to a neighbouring fold are not removed. Settings that were
        chosen from the data (``tune``) are not chosen again. ``adaptive`` starts from its model
        of all realizations: it keeps the smooth part and the number of switches, and fits
        amplitudes and times again.

        Examples
        --------
        >>> import tvsysid as tv
        >>> simulation = tv.simulate.Joint(stiffness=tv.simulate.SineWave()).simulate(
        ...     120, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
        >>> ensemble = tv.preprocess.segment(
        ...     tv.preprocess.decimate(simulation.recording, 100), period=2.0)
        >>> found = tv.compare(tv.preprocess.subtract_mean(ensemble), ["eirf", "sds"])
        >>> {label: int(vaf.mean()) for label, vaf in found.vaf.items()}
        {'eirf': 95, 'sds': 93}
        >>> {label: int(vaf.mean()) for label, vaf in found.held_out_vaf().items()}
        {'eirf': 84, 'sds': 92}
        """
        return held_out_vaf(self.ensemble, self.methods, self.models, folds, jobs, progress)


def compare(
    ensemble: Ensemble,
    methods: Iterable[str | Method] = DEFAULT_METHODS,
    *,
    tune: bool = False,
    progress: Progress = no_progress,
) -> Comparison:
    """Identify one ensemble by several methods, as ``tvsysid identify`` does.

    A method that cannot serve the ensemble is skipped. One that raises an error has failed, and
    the others finish.

    Parameters
    ----------
    ensemble
        Realizations, mean subtracted.
    methods
        Keys with settings if need be (``"sds:window=0.2"``), ``"module:Class"``, or objects with
        ``identify``. The default is ``adaptive``, which is recommended, and the paper's five.
    tune
        Whether each method's settings are chosen from the data first.
    progress
        Function that is called before each method with the number of methods done and of all.

    Raises
    ------
    InputError
        For an unknown method, or if every method failed or was skipped; says why.

    Warns
    -----
    DataQualityWarning
        For warnings of the methods, and for a method that states standard errors but has no band.

    Examples
    --------
    >>> import tvsysid as tv
    >>> simulation = tv.simulate.Joint(stiffness=tv.simulate.SineWave()).simulate(
    ...     40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    >>> ensemble = tv.preprocess.segment(
    ...     tv.preprocess.decimate(simulation.recording, 100), period=2.0)
    >>> tv.compare(ensemble, ["sds", "birf"]).summary()[["method", "stiffness (N·m/rad)"]].round(1)
      method  stiffness (N·m/rad)
    0    sds                 ...
    1   birf                 ...
    """
    chosen = _by_label([methods] if isinstance(methods, str) else methods)
    models: dict[str, Model] = {}
    predicted: dict[str, Array] = {}
    evidence: dict[str, Evidence] = {}
    skipped: dict[str, str] = {}
    failed: dict[str, str] = {}
    with single_thread():
        for number, label in enumerate(chosen):
            progress(number, len(chosen))
            method = chosen[label]
            try:
                if isinstance(method, Tuned) or (tune and method.can_be_tuned):
                    method, evidence[label] = method.tuned(ensemble)
                model = method.identify(ensemble)
                predicted[label] = model.predict(ensemble)
            except SkippedError as error:
                skipped[label] = error.reason
            except Exception as error:  # a user's method may raise anything; the others go on
                failed[label] = describe_error(error)
            else:
                chosen[label], models[label] = method, model
                _warn_without_band(label, model)
    if not models:
        reasons = [f"{label}: {why}" for label, why in skipped.items()]
        reasons += [f"method {label}: {why}" for label, why in failed.items()]
        raise InputError("; ".join(reasons))
    return Comparison(ensemble, chosen, models, predicted, evidence, skipped, failed)


def _table(rows: list[dict[str, Any]]) -> pd.DataFrame:
    import pandas as pd  # noqa: PLC0415  # heavy

    return pd.DataFrame(rows)


def _by_label(methods: Iterable[str | Method]) -> dict[str, Method]:
    """Return methods by their label in results. The same label may not name two methods."""
    given: dict[str, str | Method] = {}
    for item in methods:
        if given.setdefault(label := label_of(item), item) != item:
            raise InputError(
                f"compare: two methods have the name {label}. Settings that are fields of the "
                "class tell them apart"
            )
    if not given:
        raise InputError("compare: expected at least one method, got none")
    return {label: parse(item) if isinstance(item, str) else item for label, item in given.items()}


def _warn_without_band(label: str, model: Model) -> None:
    """Warn if a method states standard errors but has none for this stiffness."""
    stiffness = model.estimates.get("stiffness")
    error = None if stiffness is None else stiffness.standard_error
    if error is not None and error.absent:
        warnings.warn(f"{label}: no band: {error.absent}", DataQualityWarning, stacklevel=3)


def _bands(model: Model) -> dict[str, Array]:
    """Return the 95 % bands of the impedance and of all other estimates over time."""
    none = np.full((2, len(model.time)), np.nan)
    bands = dict.fromkeys(IMPEDANCE, none)
    for name, estimate in model.estimates.items():
        if estimate.axes in OVER_TIME:
            band = np.reshape(_band(estimate), (2, -1))
            # The mean of several realizations has no band.
            bands[name] = band if band.shape == none.shape else none
    return bands


def _band(estimate: Estimate) -> tuple[Array, Array]:
    """Return the 95 % band; all NaN, without a warning, if there is none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return estimate.band()
