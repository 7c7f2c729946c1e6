"""Hold the results of several methods on one ensemble, and compare them."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.errors import DataQualityWarning, describe_error, without_quality_warnings
from tvsysid.methods import Evidence, Method, centered_channels
from tvsysid.methods.base import Kind
from tvsysid.metrics import time_varying_vaf, vaf
from tvsysid.models import IMPEDANCE, OVER_TIME, Model
from tvsysid.numerics.bands import half_width, mean_known, mean_of
from tvsysid.numerics.threads import single_thread
from tvsysid.progress import Progress, no_progress
from tvsysid.quality import Diagnosis
from tvsysid.recommendation import Answer, Recommendation, answer, recommend
from tvsysid.signals import Array, Ensemble

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

FOLDS = 5
NAMED_INPUTS: tuple[Kind, ...] = "reference", "scheduling"  # kinds whose channel the user names
ROUNDING = 1e-9  # relative; a quantity that varies less is constant
SUMMARY = ["method", "stiffness (N·m/rad)", "half_band (N·m/rad)", "lowest (N·m/rad)"]
SUMMARY += ["lowest at (s)", "highest (N·m/rad)", "highest at (s)", "viscosity (N·m·s/rad)"]
SUMMARY += ["inertia (kg·m²)", "VAF (%)"]
PRINTED = {  # headings of the columns of the summary that are printed
    "method": "method",
    "stiffness (N·m/rad)": "mean",
    "half_band (N·m/rad)": "band ±",
    "lowest (N·m/rad)": "lowest",
    "highest (N·m/rad)": "highest",
}


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
        Evidence for settings that were chosen from the data.
    skipped
        Reason why a method cannot identify the ensemble, for each method that was not run.
    failed
        Error message of each method that failed.
    diagnosis
        Diagnosis of the data with the methods' reference, if known.
    held_out
        Result of :meth:`predict_held_out`, if known.
    unnamed_references
        A sentence for each channel outside the ensemble that moves the angle.
    """

    ensemble: Ensemble
    methods: Mapping[str, Method]
    models: Mapping[str, Model]
    predicted: Mapping[str, Array]
    evidence: Mapping[str, Evidence]
    skipped: Mapping[str, str]
    failed: Mapping[str, str]
    diagnosis: Diagnosis | None = None
    held_out: Mapping[str, Array] | None = None
    unnamed_references: tuple[str, ...] = ()

    @cached_property
    def vaf(self) -> dict[str, Array]:
        """Variance accounted for in each realization in %, by label, shape (realization,).

        It is computed on the same realizations that the model was fitted to. A method with many
        parameters has a high VAF even where its stiffness is noise: see :attr:`held_out_vaf`.
        """
        return {label: vaf(self._torque, each) for label, each in self.predicted.items()}

    @cached_property
    def time_varying_vaf(self) -> dict[str, Array]:
        """Variance accounted for at each time over realizations in %, by label, shape (time,).

        Empty for a single realization.
        """
        several = self.predicted if len(self.ensemble) > 1 else {}
        return {label: time_varying_vaf(self._torque, each) for label, each in several.items()}

    @property
    def _torque(self) -> Array:
        return self.ensemble.torque[:, self.ensemble.core]

    @property
    def inputs(self) -> dict[Kind, str]:
        """Channels that the methods read beside angle and torque, by kind of input."""
        methods = (self.methods[label] for label in self.models)
        return {item.kind: item.name for method in methods for item in method.inputs}

    @cached_property
    def recommendation(self) -> Recommendation:
        """Recommended method for the ensemble, given the channels that the methods use."""
        channels = map(self.inputs.get, NAMED_INPUTS)
        recommended = recommend(self.ensemble, *channels, diagnosis=self.diagnosis)
        unnamed = (*self.unnamed_references, *recommended.unnamed_references)
        return attrs.evolve(recommended, unnamed_references=unnamed)

    @cached_property
    def held_out_torque(self) -> Mapping[str, Array]:
        """Measured and predicted torque of held-out realizations: :meth:`predict_held_out`."""
        return self.predict_held_out() if self.held_out is None else self.held_out

    @cached_property
    def held_out_vaf(self) -> dict[str, Array]:
        """VAF of held-out realizations in %, by label, shape (realization,).

        Examples
        --------
        >>> import tvsysid as tv
        >>> simulation = tv.simulate.Joint(stiffness=tv.simulate.SineWave()).simulate(
        ...     120, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
        >>> ensemble = tv.preprocess.segment(
        ...     tv.preprocess.decimate(simulation.recording, 100), period=2.0)
        >>> comparison = tv.compare(tv.preprocess.subtract_mean(ensemble), ["eirf", "sds"])
        >>> {label: int(vaf.mean()) for label, vaf in comparison.vaf.items()}
        {'eirf': 95, 'sds': 93}
        >>> {label: int(vaf.mean()) for label, vaf in comparison.held_out_vaf.items()}
        {'eirf': 84, 'sds': 92}
        """
        return {label: vaf(*each) for label, each in self.held_out_torque.items()}

    @cached_property
    def answer(self) -> Answer:
        """Stiffness to report, and its trust. Predicts held-out realizations if necessary."""
        return answer(
            self.ensemble, self.methods, self.models, self.recommendation, self.held_out_vaf
        )

    def __repr__(self) -> str:
        answer, table = self.answer, self.summary().rename(columns=PRINTED)
        table["spread ±"] = table.method.map({answer.label: answer.difference})
        table["VAF (%)"] = table.method.map(answer.vaf)
        table["method"] = table.method.map("{:.30} ".format)
        title = "stiffness (N·m/rad) and VAF of held-out realizations:"
        return "\n".join(
            [
                "\n  ".join(answer.lines),
                f"\n{'' if answer.is_stated else 'not valid: '}{title}",
                table[[*PRINTED.values(), "spread ±", "VAF (%)"]].to_string(
                    index=False, na_rep="-", float_format="{:.1f}".format
                ),
                "",
                *answer.changes,
                *(f"{label} is skipped: {why}" for label, why in self.skipped.items()),
                *(f"{label} failed: {why}" for label, why in self.failed.items()),
                f"{', '.join(self.models)} on {self.ensemble!r}",
            ]
        )

    def plot(self, title: str = "") -> Figure:
        """Draw the estimates of all methods."""
        from tvsysid.figures import plot  # noqa: PLC0415  # figures import this

        return plot(self, title)

    def summary(self) -> pd.DataFrame:
        """Return a table with a row for each method.

        It has means over time, extremes of the stiffness with their times (NaN where it is
        constant), and the VAF. The column names hold the units. ``half_band`` is the mean half
        width of the stiffness's 95 % band.
        """
        import pandas as pd  # noqa: PLC0415  # heavy

        rows = [
            (
                label,
                *describe_values(model.stiffness, model.band("stiffness"), model.time),
                *map(mean_of, (model.viscosity, model.inertia, self.vaf[label])),
            )
            for label, model in self.models.items()
        ]
        return pd.DataFrame(rows, columns=SUMMARY)

    def over_time(self) -> pd.DataFrame:
        """Return a table with a row for each method and time.

        It has every quantity over time with its 95 % band, and the time-varying VAF.
        """
        import pandas as pd  # noqa: PLC0415  # heavy

        tables = []
        for label, model in self.models.items():
            table = pd.DataFrame({"time_s": model.time, "method": label})
            further = [name for name, each in model.estimates.items() if each.axes in OVER_TIME]
            for name in dict.fromkeys([*IMPEDANCE, *further]):
                table[name] = model.over_time(name)
                table[f"{name}_lower"], table[f"{name}_upper"] = model.band(name)
            table["time_varying_vaf"] = self.time_varying_vaf.get(label, np.nan)
            tables.append(table)
        return pd.concat(tables, ignore_index=True)

    def over_variables(self) -> pd.DataFrame:
        """Return a table with a row for each method, quantity and value of a measured variable.

        It has the estimates with their 95 % bands.
        """
        import pandas as pd  # noqa: PLC0415  # heavy

        tables = (
            {
                "method": label,
                "variable": variable,
                "value": coordinates,
                "quantity": name,
                "unit": estimate.unit,
                "estimate": estimate.values,
                "lower": estimate.band()[0],
                "upper": estimate.band()[1],
            }
            for label, model in self.models.items()
            for variable, coordinates in model.coordinates.items()
            for name, estimate in model.estimates.items()
            if estimate.axes == (variable,)
        )
        return pd.concat([pd.DataFrame(), *map(pd.DataFrame, tables)], ignore_index=True)

    def predict_held_out(
        self, folds: int = FOLDS, *, progress: Progress = no_progress
    ) -> dict[str, Array]:
        r"""Return measured and predicted torque of held-out realizations in N·m, by label.

        Each fold holds consecutive realizations of the record. Slow changes thus lower the VAF as
        they would in a new experiment. Each method, with its settings in ``methods``, is fitted to
        all folds but one, and predicts the torque of the remaining fold:

        .. math:: \hat y_r(t) = \bar y(t) + \hat m(\theta_r - \bar\theta)(t) - \overline{\hat m}(t)

        If the ensemble's mean was subtracted, the means (bars) are computed again without the
        held-out realizations. A prediction therefore uses no torque of its realization.

        Parameters
        ----------
        folds
            Number of folds, from two to the number of realizations. Each method is fitted once for
            each fold.
        progress
            As for :func:`compare`.

        Returns
        -------
        dict
            :math:`y_r - \bar y` and :math:`\hat y_r - \bar y`, shape (2, realization, time). NaN
            where a method cannot be fitted without the fold, for a single realization, and for
            two realizations whose mean was subtracted.

        Warns
        -----
        DataQualityWarning
            If a method cannot be fitted without a fold, with the reason.

        Notes
        -----
        Samples of context that belong to a neighbouring fold are not removed. Settings that were
        chosen from the data (``tune``) are not chosen again. ``adaptive`` starts from its model
        of all realizations: it keeps the smooth part and the number of switches, and fits
        amplitudes and times again.
        """
        ensemble = self.ensemble
        shape = 2, len(ensemble), ensemble.samples
        torques = {label: np.full(shape, np.nan) for label in self.models}
        if len(ensemble) < 2 + ensemble.mean_subtracted:
            return torques  # a single realization less its mean is zero
        parts = np.array_split(np.concatenate(ensemble.runs), min(folds, len(ensemble)))
        with single_thread():
            for number, (part, label) in enumerate(product(parts, self.models)):
                progress(number, len(parts) * len(self.models))
                try:
                    torques[label][:, part] = self._predict_part(part, label)
                except Exception as error:  # a user's method may raise anything; the others go on
                    reason = (
                        f"{label}: no held-out VAF where the method cannot be fitted without a "
                        f"fold: {describe_error(error)}"
                    )
                    warnings.warn(reason, DataQualityWarning, stacklevel=2)
        return torques

    def _predict_part(self, held_out: NDArray[np.int64], label: str) -> Array:
        """Return measured torque of realizations, and that predicted by a fit to the others."""
        ensemble, method = self.ensemble, self.methods[label]
        kept = np.setdiff1d(np.arange(len(ensemble)), held_out)

        def deviation(values: Array) -> Array:
            return values - ensemble.mean_subtracted * mean_known(values[kept])

        angle, torque = deviation(ensemble.angle), deviation(ensemble.torque)
        measured = torque[held_out, ensemble.core]
        torque[held_out] = 0.0  # hide it from a method that reads the torque to predict it
        channels = dict(ensemble.channels)
        for name in centered_channels([method]):
            channels[name] = deviation(channels[name])
        given = attrs.evolve(ensemble, angle=angle, torque=torque, channels=channels)
        with without_quality_warnings():
            # The fit to all realizations has warned already.
            model = method.refit(given.select(kept), self.models[label])
            predicted = deviation(model.predict(given))
        return np.stack([measured, predicted[held_out]])


def describe_values(
    values: Array, band: Sequence[Array] | Array, times: ArrayLike = np.nan
) -> tuple[float, ...]:
    """Return mean, mean half width of the band, lowest and its time, highest and its time.

    The extremes of a constant are NaN.
    """
    known = values[np.isfinite(values)]
    at = np.broadcast_to(times, values.shape)[np.isfinite(values)]
    extremes = [np.nan] * 4
    if known.size and np.ptp(known) > ROUNDING * abs(known.max()):
        places = np.argmin(known), np.argmax(known)
        extremes = [each for place in places for each in (known[place], at[place])]
    return mean_of(values), mean_of(half_width(band)), *extremes
