"""Align realizations to the torque that they should have followed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.preprocess.account import Account, Step
from tvsysid.preprocess.steps import check_seconds, every_signal
from tvsysid.signals import Array, Ensemble


def align(ensemble: Ensemble, reference: str, search: float = 0.5, max_shift: float = 0.25) -> Step:
    r"""Shift each realization to where its torque is nearest to the reference, and exclude those that are far off.

    .. math:: \tau_r = \arg\min_{|\tau| \le \text{search}} \sum_t (y_r(t + \tau) - y_\text{ref}(t))^2

    (equation 27 of van de Ruit et al. 2021). Angle, torque and channels move together by whole samples; the reference
    stays. What moves in from either side was recorded there: it comes from the ensemble's context, which is shorter
    by ``search`` afterwards.

    Parameters
    ----------
    ensemble
        With a context of at least ``search``.
    reference
        Name of the channel that holds the torque to follow, in N·m.
    search
        Largest shift tried, in s.
    max_shift
        Realizations that need a larger shift (in s) are excluded.

    Returns
    -------
    Step
        The ensemble's onsets are shifted as well, so that realizations that moved apart no longer follow each other.

    Raises
    ------
    InputError
        If there is no such channel, the context is too short, or no realization is left.

    Notes
    -----
    The torque that answers the perturbation also moves the best fit, by some 7 ms (SD). A shift by that much adds
    voluntary torque that cancels the answer's part at the task's frequency, and so lowers the identified stiffness: by
    15 % for a virtual participant who follows the target perfectly. Where that matters, exclude by the shift but
    leave the realizations where they were: ``preparation.recorded.select(preparation.account.kept)``.
    """
    check_seconds("align", positive=True, search=search, max_shift=max_shift)
    if reference not in ensemble.channels:
        raise InputError(
            f"align: there is no channel {reference!r} to align to; "
            f"channels: {', '.join(map(repr, ensemble.channels)) or 'none'}; without a torque to follow, leave it out"
        )
    rate = ensemble.sampling_rate
    reach = round(search * rate)
    if ensemble.context < reach:
        raise InputError(
            f"align: shifts of up to {search:g} s need that much context, but the realizations have "
            f"{ensemble.context / rate:g} s; segment with more context"
        )
    assert ensemble.onsets is not None
    core = ensemble.core
    target = ensemble.channels[reference][:, core]
    shifts = best_shifts(ensemble.torque[:, core.start - reach : core.stop + reach], target)
    left = ensemble.angle.shape[1] - 2 * reach
    index = np.arange(reach, reach + left) + shifts[:, None]

    def moved(x: Array) -> Array:
        return np.take_along_axis(x, index, axis=1)

    signals = every_signal(ensemble, moved)
    signals["channels"][reference] = ensemble.channels[reference][:, reach : reach + left]
    aligned = replace(ensemble, **signals, context=ensemble.context - reach, onsets=ensemble.onsets + shifts / rate)
    judged = np.abs(shifts) / rate
    account = replace(Account.of(ensemble, "alignment", judged, max_shift, "s"), shifts=shifts / rate)
    if not account.kept.any():
        raise InputError(
            f"align: every realization needs a shift of more than {max_shift:g} s; "
            f"are the signs of the torque and of channel {reference!r} the same, and their times?"
        )
    return Step(aligned.select(account.kept), account, aligned.torque[:, aligned.core], target.mean(axis=0))


def best_shifts(torque: Array, target: Array) -> NDArray[np.int64]:
    """Shift in samples that brings each torque nearest to its target, positive where the torque comes late.

    Of shape (realization,) and from -reach to reach, for torques (realization, reach + time + reach) and targets
    (realization, time).
    """
    samples = target.shape[1]
    windows = sliding_window_view(torque, samples, axis=1)
    # The target's own power is the same for all shifts.
    errors = np.einsum("rst,rst->rs", windows, windows) - 2 * np.einsum("rst,rt->rs", windows, target)
    return np.asarray(np.argmin(errors, axis=1) - (torque.shape[1] - samples) // 2)
