"""Several methods on one ensemble: what each found, and how well it explains the torque."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from itertools import repeat
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.checked import Frozen
from tvsysid.errors import DataQualityWarning, InputError, describe_error
from tvsysid.estimates import IMPEDANCE
from tvsysid.methods import DEFAULT_METHODS, Evidence, Tuned, deviating_channels, label_of, parse
from tvsysid.methods.adaptive.model import AdaptiveModel
from tvsysid.methods.apply import Identified, Identifies, identify
from tvsysid.methods.base import Method, SkippedError, inputs_of
from tvsysid.metrics import time_varying_vaf, vaf
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_known, mean_of
from tvsysid.numerics.threads import single_thread
from tvsysid.quality import Diagnosis, diagnose
from tvsysid.quality.reflexes import predicts_better
from tvsysid.recommendation import Recommendation, Trust, recommend, trust_in
from tvsysid.recommendation.trust import LOOP, WRONG
from tvsysid.showing import Progress, Shown, reported, summary_html
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import with_settings

if TYPE_CHECKING:
    import pandas as pd

FOLDS = 5  # into which realizations are dealt, to predict each from the others
BETTER = 0.05  # probability below which realizations are taken to be predicted better


@attrs.frozen(eq=False, repr=False)
class Comparison(Shown, Frozen):
    """What several methods found in one ensemble; mappings are by the methods' labels.

    ``methods`` have the settings that were used, and ``evidence`` says why where these were chosen
    from the data. ``models`` are those of the methods that succeeded; ``skipped`` says why a method
    could not serve the ensemble, ``failed`` why one failed. ``bands`` are lower and upper limits of
    the 95 % bands of estimates over time, by quantity; NaN where there is none. ``vaf`` is the
    variance of the recorded torque accounted for in each realization, in per cent, shape
    (realization,), ``time_varying_vaf`` that at each time over realizations, shape (time,).

    Notes
    -----
    The torque is that of the very data that were identified: a method with many parameters has a high VAF even where
    its stiffness is noise. :meth:`held_out_vaf` is that of realizations that were left out.
    """

    ensemble: Ensemble
    methods: Mapping[str, Identifies]
    models: Mapping[str, Model]
    skipped: Mapping[str, str]
    bands: Mapping[str, Mapping[str, tuple[Array, Array]]]
    vaf: Mapping[str, Array]
    time_varying_vaf: Mapping[str, Array]
    evidence: Mapping[str, Evidence]
    failed: Mapping[str, str]

    @property
    def has_bands(self) -> bool:
        """Whether any stiffness has a band."""
        return any(np.isfinite(limits["stiffness"]).any() for limits in self.bands.values())

    @cached_property
    def recommendation(self) -> Recommendation:
        """Which method suits these data, and why, with the reference or the variable that a method here takes."""
        inputs = {
            item.kind: item.name for method in self.methods.values() for item in inputs_of(method)
        }
        return recommend(
            self.ensemble,
            inputs.get("reference"),
            inputs.get("scheduling"),
            model=self._adaptive[1],
        )

    @property
    def leading(self) -> str:
        """Label of the recommended method: what suits the data, else ``adaptive``, else the first."""
        if len(self.models) == 1:
            return next(iter(self.models))
        methods = {label: self.methods[label] for label in self.models}
        return self.recommendation.leading(methods, self.evidence) or self._adaptive[0]

    @property
    def is_suited(self) -> bool:
        """Whether the ``leading`` method suits the data."""
        label = self.leading
        return self.recommendation.leading({label: self.methods[label]}, self.evidence) is not None

    def trust(
        self,
        diagnosis: Diagnosis | None = None,
        held_out_vaf: float = math.nan,
        unnamed_references: Sequence[str] = (),
    ) -> Trust:
        """Return how far the stiffness of the ``leading`` method can be trusted, and why not further.

        Parameters
        ----------
        diagnosis
            Of the data, if it is known better than by ``recommendation``.
        held_out_vaf
            Typical VAF in % of realizations held out, by the leading method.
        unnamed_references
            A sentence for each channel outside the ensemble that moves the angle.
        """
        label, best = self.leading, self.recommendation
        unnamed = (*unnamed_references, *best.unnamed_references)
        known = diagnosis or best.diagnosis
        return trust_in(
            self.models[label],
            self.methods[label],
            best,
            self.is_suited,
            known,
            held_out_vaf,
            unnamed,
        )

    @property
    def _adaptive(self) -> tuple[str, Model]:
        """Label and model of ``adaptive``; of the first method where it is not among them."""
        every = list(self.models.items())
        return next((each for each in every if isinstance(each[1], AdaptiveModel)), every[0])

    def __repr__(self) -> str:
        failed = f"; failed: {', '.join(self.failed)}" if self.failed else ""
        return f"Comparison({', '.join(self.models)} on {self.ensemble!r}{failed})"

    def _repr_html_(self) -> str:
        table, told = self.summary(), {"skipped": self.skipped, "failed": self.failed}
        notes = [
            f"{label} {what}: {why}" for what, each in told.items() for label, why in each.items()
        ]
        if (trust := self.trust()).level == "none":
            notes = [f"No stiffness is stated. {' '.join(trust.reasons)}", *notes]
        about = f"{', '.join(self.models)} on {self.ensemble!r}"
        return summary_html(
            "Comparison", about, list(map(str, table.columns)), table.itertuples(index=False), notes
        )

    def summary(self) -> pd.DataFrame:
        """A row for each method: means over time, extremes of the stiffness with their times, VAF.

        Units in the names.

        ``half_band`` is the mean half width of the stiffness's 95 % band.
        """
        import pandas as pd  # noqa: PLC0415  # heavy

        return pd.DataFrame(self.rows())

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows of :meth:`summary`."""
        rows: list[dict[str, Any]] = []
        for label, model in self.models.items():
            stiffness = model.stiffness
            known = np.isfinite(
                stiffness
            ).any()  # a method may estimate it over another variable than time
            lowest, highest = (
                int(place(stiffness)) if known else 0 for place in (np.nanargmin, np.nanargmax)
            )
            lower, upper = self.bands[label]["stiffness"]
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

    def vaf_over_time(self) -> dict[str, Array]:
        """``time_varying_vaf`` for pictures: none of a single realization, over which there is no variance."""
        return dict(self.time_varying_vaf) if len(self.ensemble) > 1 else {}

    def held_out_vaf(
        self, folds: int = FOLDS, *, progress: Progress | None = None
    ) -> dict[str, Array]:
        r"""Variance accounted for of realizations that were left out, in per cent, shape (realization,), by label.

        Realizations are dealt, in the order of the record, into so many folds of consecutive ones,
        whose slow changes so count as they would in a new experiment. Each method, with the
        settings that it has in ``methods``, is identified from all folds but one, and predicts the
        torque of that one:

        .. math:: \hat y_r(t) = \bar y(t) + \hat m(\theta_r - \bar\theta)(t) - \overline{\hat m}(t)

        Where the ensemble's mean was subtracted, the means (bars) are those of the realizations
        kept, subtracted anew from all: nothing of a realization's torque is in its prediction. Its
        VAF is that of its deviation from that mean, :func:`tvsysid.metrics.vaf` of :math:`y_r -
        \bar y` and :math:`\hat y_r - \bar y`.

        Parameters
        ----------
        folds
            At least two; as many as there are realizations where these are fewer. It takes as many
            identifications by each method.
        progress
            As of :func:`compare`.

        Returns
        -------
        dict
            NaN where a method cannot identify without the fold, which is warned of, and for a
            single realization, or two whose mean was subtracted.

        Raises
        ------
        InputError
            For fewer than two folds.

        Warns
        -----
        DataQualityWarning
            If a method cannot identify from the realizations kept; says why.

        Notes
        -----
        The samples of context around realizations next to a fold are the fold's own. Settings that were chosen from the
        data (``tune``) were chosen from all of them, and are not chosen anew. ``adaptive`` starts from what it found in
        all of them: it keeps the smooth part and the number of switches, and fits amplitudes and places anew.
        Folds are identified in turn: this takes less time than to start processes for them.

        Examples
        --------
        >>> import tvsysid as tv
        >>> simulation = tv.simulate.Joint(stiffness=tv.simulate.SineWave()).simulate(
        ...     120, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
        >>> ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), period=2.0)
        >>> found = tv.compare(tv.preprocess.subtract_mean(ensemble), ["eirf", "sds"])
        >>> {label: int(vaf.mean()) for label, vaf in found.vaf.items()}
        {'eirf': 95, 'sds': 93}
        >>> {label: int(vaf.mean()) for label, vaf in found.held_out_vaf().items()}
        {'eirf': 84, 'sds': 92}
        """
        if isinstance(folds, bool) or not isinstance(folds, (int, np.integer)) or folds < 2:
            raise InputError(f"held_out_vaf: folds must be a whole number from 2 on, got {folds!r}")
        ensemble = self.ensemble
        parts = np.array_split(np.concatenate(ensemble.runs), min(folds, len(ensemble)))
        found = {label: np.full(len(ensemble), np.nan) for label in self.models}
        failed: dict[str, str] = {}
        least = (
            3 if ensemble.mean_subtracted else 2
        )  # of one realization kept, nothing is left beside its mean
        if len(ensemble) == 2 < least:
            text = (
                "no held-out VAF: with the mean over realizations subtracted, it takes three "
                "realizations, got 2"
            )
            warnings.warn(text, DataQualityWarning, stacklevel=2)
        jobs = [(label, part) for part in parts for label in found if len(ensemble) >= least]
        with single_thread(), reported(progress, "identifying without a part") as advance:
            for number, (label, part) in enumerate(jobs):
                advance(number, len(jobs))
                try:
                    found[label][part] = self._vaf_of(part, label)
                except (Exception, SystemExit) as error:  # a method of one's own may raise anything
                    failed.setdefault(label, describe_error(error))
        for reason in dict.fromkeys(failed.values()):
            labels = ", ".join(label for label, own in failed.items() if own == reason)
            text = (
                f"{labels}: no held-out VAF where a fold of the realizations cannot be left "
                f"out: {reason}"
            )
            warnings.warn(text, DataQualityWarning, stacklevel=2)
        return found

    def _vaf_of(self, left: NDArray[np.int64], label: str) -> Array:
        """VAF of the realizations ``left`` out, by what a method identifies from the others.

        (realization,).
        """
        method, ensemble = self.methods[label], self.ensemble
        kept = np.setdiff1d(np.arange(len(ensemble)), left)
        every = ensemble
        if ensemble.mean_subtracted:
            names = [name for name in deviating_channels([method]) if name in ensemble.channels]
            deviations = {
                name: values - values[kept].mean(axis=0)
                for name, values in _acting(ensemble, names).items()
            }
            own = {name: deviations.pop(name) for name in ("angle", "torque")}
            every = attrs.evolve(ensemble, **own, channels={**ensemble.channels, **deviations})
        torque = every.torque[:, every.core]
        unseen = np.array(every.torque)
        unseen[left] = 0.0  # whatever predicts cannot look at it
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)  # that of the whole was warned of
            known = every.select(kept)
            unseen_torque = attrs.evolve(every, torque=unseen)
            if isinstance(method, (Method, Tuned)):
                model = method.refit(known, self.models[label])
            else:
                model = identify(method, known, label).model
            values = model.predict(unseen_torque)
        if ensemble.mean_subtracted:
            values = values - mean_known(values[kept])
        return vaf(torque[left], values[left])

    def over_time(self) -> pd.DataFrame:
        """A row for each method and time: every quantity over time with its 95 % band, and the time-varying VAF."""
        import pandas as pd  # noqa: PLC0415  # heavy

        return pd.DataFrame(self.rows_over_time())

    def rows_over_time(self) -> list[dict[str, Any]]:
        """Return the rows of :meth:`over_time`."""
        rows: list[dict[str, Any]] = []
        for label, model in self.models.items():
            columns: dict[str, Iterable[Any]] = {"time_s": model.time, "method": repeat(label)}
            for name, (lower, upper) in self.bands[label].items():
                columns |= {
                    name: model.over_time(name),
                    f"{name}_lower": lower,
                    f"{name}_upper": upper,
                }
            columns["time_varying_vaf"] = self.time_varying_vaf[label]
            rows += _rows(columns)
        return rows

    def over_variables(self) -> pd.DataFrame:
        """A row for each method, quantity and value of a variable that it was estimated over, with its 95 % band."""
        import pandas as pd  # noqa: PLC0415  # heavy

        return pd.DataFrame(self.rows_over_variables())

    def rows_over_variables(self) -> list[dict[str, Any]]:
        """Return the rows of :meth:`over_variables`.

        None where nothing was estimated over a variable.
        """
        rows: list[dict[str, Any]] = []
        for label, model in self.models.items():
            for name, estimate in model.estimates.items():
                if len(estimate.axes) > 1 or estimate.axes[0] not in model.coordinates:
                    continue
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", DataQualityWarning)  # that there is none
                    lower, upper = estimate.band()
                over = estimate.axes[0]
                columns: dict[str, Iterable[Any]] = {
                    "method": repeat(label),
                    "variable": repeat(over),
                }
                columns |= {
                    "value": model.coordinates[over],
                    "quantity": repeat(name),
                    "unit": repeat(estimate.unit),
                }
                rows += _rows(
                    columns | {"estimate": estimate.values, "lower": lower, "upper": upper}
                )
        return rows


def compare(
    ensemble: Ensemble,
    methods: Iterable[str | Identifies] = DEFAULT_METHODS,
    *,
    tune: bool = False,
    progress: Progress | None = None,
) -> Comparison:
    """Identify one ensemble by several methods; what ``tvsysid identify`` does.

    One that cannot serve the ensemble is skipped. One that raises an error has failed, and the
    others finish.

    Parameters
    ----------
    ensemble
        Realizations, mean subtracted.
    methods
        Keys with settings if need be (``"sds:window=0.2"``), ``"module:Class"``, or objects with
        ``identify``; by default ``adaptive``, which is recommended, and the paper's five.
    tune
        Whether each method's settings are chosen from the data first.
    progress
        Called with the number of methods done and of all, before each; None shows a bar in a
        notebook.

    Raises
    ------
    InputError
        For an unknown method, or if every method failed or was skipped; says why.

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
                f"compare: two methods have the name {label_of(item)}; with settings as fields their "
                "settings tell them apart"
            )
    if not named:
        raise InputError("compare: expected a method at least, got none")
    chosen = {
        label: parse(item) if isinstance(item, str) else item for label, item in named.items()
    }
    found: dict[str, Identified] = {}
    predicted: dict[str, Array] = {}
    bands: dict[str, dict[str, tuple[Array, Array]]] = {}
    skipped: dict[str, str] = {}
    failed: dict[str, str] = {}
    with single_thread(), reported(progress, "identifying") as advance:
        for number, (label, method) in enumerate(chosen.items()):
            advance(number, len(chosen))
            try:
                one = identify(method, ensemble, label, tune=tune or isinstance(method, Tuned))
                predicted[label], bands[label] = (
                    one.model.predict(ensemble),
                    _bands_of(label, one.model),
                )
                found[label] = one
            except SkippedError as error:
                skipped[label] = str(error)
            except (Exception, SystemExit) as error:
                failed[label] = describe_error(error)
    if not found:
        reasons = [f"{label}: {why}" for label, why in skipped.items()]
        reasons += [f"method {label}: {why}" for label, why in failed.items()]
        raise InputError("; ".join(reasons))
    evidence = {label: each.evidence for label, each in found.items() if each.evidence is not None}
    chosen |= {label: _with_settings(chosen[label], each) for label, each in evidence.items()}
    torque = ensemble.torque[:, ensemble.core]
    return Comparison(
        ensemble,
        chosen,
        {label: each.model for label, each in found.items()},
        skipped,
        bands,
        {label: vaf(torque, values) for label, values in predicted.items()},
        {label: time_varying_vaf(torque, values) for label, values in predicted.items()},
        evidence,
        failed,
    )


def delay_to_correct(
    cut: Callable[[float], Ensemble], judged: Ensemble, method: str
) -> tuple[float, str]:
    """Choose how much of a delay of the torque to correct, in s: all, unless half or none of it predicts better.

    A joint that is not of second order, or a fixture that gives way, looks like a delay of another
    size. So realizations held out decide (p < 0.05), by ``adaptive``; of a single realization the
    ``method``, if it holds out fifths of the record.

    Parameters
    ----------
    cut
        Returns the ensemble with a delay in s corrected.
    judged
        What is diagnosed: the ensemble as it was recorded, or pieces of it.
    method
        Of a single realization, which ``adaptive`` cannot identify.

    Returns
    -------
    float
        Delay to correct in s; 0 where none is found or can be, or the data have worse faults.
    str
        What was found and done, empty where no delay is found.
    """
    try:
        faults = {each.name: each for each in diagnose(judged).findings}
    except InputError:  # realizations are too few, or too short
        return 0.0, ""
    if "delay" not in faults or faults.keys() & (WRONG | LOOP).keys():
        return 0.0, ""
    found, shares = faults["delay"].what.partition(";")[0], np.array([0.0, 0.5, 1.0])
    delays = shares * faults["delay"].value / 1000
    try:
        ensembles = [cut(delay) for delay in delays]
        method, predicted = _predicted(ensembles, method)
    except InputError as error:
        return 0.0, f"{found}; none of it is corrected: {error}"
    means = [each.mean() for each in predicted]
    if not np.isfinite(means).all():
        return float(delays[-1]), f"{found}; all of it is corrected"
    best, count = int(np.argmax(means)), min(map(len, predicted))
    better, _ = predicts_better(*(100 - predicted[which][:count] for which in (best, -1)))
    chosen = best if count == 1 or better < BETTER else 2
    vaf = "{:.1f} % as recorded, {:.1f} with half and {:.1f} with all of it corrected".format(
        *means
    )
    what = f"{found}; {('none', 'half', 'all')[chosen]} of it is corrected"
    return float(delays[chosen]), f"{what}: held-out VAF of {method} is {vaf}"


def _predicted(ensembles: Sequence[Ensemble], method: str) -> tuple[str, list[Array]]:
    """Held-out VAF of each ensemble, by what was found in the first.

    Of single realizations by a ``method``.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        if len(ensembles[0]) == 1:
            models = [compare(each, [method]).models[method] for each in ensembles]
            return method, [
                np.array([model.diagnostics.details.get("vaf_folds", np.nan)]) for model in models
            ]
        found = compare(ensembles[0], ["adaptive"])
        return "adaptive", [
            attrs.evolve(found, ensemble=each).held_out_vaf(2)["adaptive"] for each in ensembles
        ]


def _rows(columns: Mapping[str, Iterable[Any]]) -> list[dict[str, Any]]:
    """Return the rows of a table, as many as its shortest column has."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=False)]


def _acting(ensemble: Ensemble, channels: Iterable[str]) -> dict[str, Array]:
    """Angle, torque and those channels that act on the joint."""
    return {name: ensemble.signal(name) for name in ("angle", "torque", *channels)}


def _with_settings(method: Identifies, evidence: Evidence) -> Identifies:
    """Method with the settings that were chosen."""
    own = method.method if isinstance(method, Tuned) else method
    return with_settings(own, **evidence.settings)


def _bands_of(label: str, model: Model) -> dict[str, tuple[Array, Array]]:
    """95 % bands of the impedance, and of what else the model estimates over time."""
    error = model.estimates["stiffness"].standard_error if "stiffness" in model.estimates else None
    if error is not None and error.absent:
        warnings.warn(f"{label}: no band: {error.absent}", DataQualityWarning, stacklevel=3)
    bands = {name: (np.full(len(model.time), np.nan),) * 2 for name in IMPEDANCE}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # that there is none
        for name, estimate in model.estimates.items():
            if estimate.axes in {("time",), ("realization", "time")}:
                lower, upper = estimate.band()
                alone = estimate.values.size == len(
                    model.time
                )  # of several realizations there is none of the mean
                bands[name] = (
                    (lower.ravel(), upper.ravel())
                    if alone
                    else (np.full(len(model.time), np.nan),) * 2
                )
    return bands
