"""Decide how much of a delay between torque and angle to correct."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import attrs
import numpy as np

from tvsysid.comparison.identify import compare
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods import parse
from tvsysid.methods.cascade.reflex_test import predicts_better
from tvsysid.quality import diagnose
from tvsysid.recommendation.trust import LOOP, WRONG
from tvsysid.signals import Array, Ensemble

SIGNIFICANCE = 0.05  # p-value below which one candidate predicts better than another


def delay_to_correct(
    cut: Callable[[float], Ensemble], diagnosed: Ensemble, method: str, jobs: int = 1
) -> tuple[float, str]:
    """Choose how much of a delay of the torque to correct: all of it, half of it or none.

    A joint that is not of second order, or a compliant fixture, looks like a delay of another
    size. So all of the delay is corrected unless half or none of it predicts held-out
    realizations better (p < 0.05). ``adaptive`` predicts them. A single realization is predicted
    by ``method``, if that holds out fifths of the record.

    Parameters
    ----------
    cut
        Function that returns the ensemble after correction of a delay in s.
    diagnosed
        Ensemble in which the delay is looked for: as recorded, or pieces of it.
    method
        Method for a single realization, which ``adaptive`` cannot identify.
    jobs
        As of :meth:`tvsysid.Comparison.held_out_vaf`.

    Returns
    -------
    float
        Delay to correct in s. 0 if none is found or can be corrected, or if worse faults are
        found.
    str
        What was found and done. Empty if no delay is found.
    """
    try:
        faults = {each.name: each for each in diagnose(diagnosed).findings}
    except InputError:  # realizations are too few, or too short
        return 0.0, ""
    if "delay" not in faults or faults.keys() & (WRONG | LOOP).keys():
        return 0.0, ""
    what = faults["delay"].what.partition(";")[0]
    delays = np.array([0.0, 0.5, 1.0]) * faults["delay"].value / 1000
    try:
        method, vafs = _held_out_vafs([cut(delay) for delay in delays], method, jobs)
    except InputError as error:
        return 0.0, f"{what}; none of it is corrected: {error}"
    means = [each.mean() for each in vafs]
    if not np.isfinite(means).all():
        return float(delays[-1]), f"{what}; all of it is corrected"
    best, count = int(np.argmax(means)), min(map(len, vafs))
    p_value, _ = predicts_better(*(100 - vafs[which][:count] for which in (best, -1)))
    chosen = best if count == 1 or p_value < SIGNIFICANCE else 2
    none, half, every = means
    return float(delays[chosen]), (
        f"{what}; {('none', 'half', 'all')[chosen]} of it is corrected: held-out VAF of {method} "
        f"is {none:.1f} % as recorded, {half:.1f} with half and {every:.1f} with all of it "
        "corrected"
    )


def _held_out_vafs(
    ensembles: Sequence[Ensemble], method: str, jobs: int
) -> tuple[str, list[Array]]:
    """Return the method that predicts, and its held-out VAF of each ensemble.

    ``adaptive`` identifies the first ensemble, and starts from this model for the others.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        if len(ensembles[0]) == 1:
            models = [parse(method).identify(each) for each in ensembles]
            folds = [each.diagnostics.details.get("vaf_folds", np.nan) for each in models]
            return method, [np.array([each]) for each in folds]
        found = compare(ensembles[0], ["adaptive"])
        each_found = (attrs.evolve(found, ensemble=each) for each in ensembles)
        return "adaptive", [each.held_out_vaf(2, jobs=jobs)["adaptive"] for each in each_found]
