"""Samples of a record and of windows about each time, for structural decomposition by subspaces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tvsysid.numerics import subspace
from tvsysid.signals import Array, Ensemble

FORGOTTEN = 0.01  # share of a reflex response's area that is cut off its end


class Line(NamedTuple):
    """Realizations that follow each other, with the context about them, as one ``piece``.

    Its sample ``first`` is the first of ``realizations`` realizations of ``samples`` samples. It
    is below 0 where lags reach beyond the context.
    """

    piece: subspace.Piece
    first: int
    realizations: int
    samples: int

    @classmethod
    def of(cls, ensemble: Ensemble, inputs: Array, run: NDArray[np.int64], lags: int) -> Line:
        """Return the line of a run of realizations.

        The inputs (realization, time, input) are delayed by ``lags`` samples.
        """
        level = 0.0 if ensemble.mean_subtracted else 1.0
        core, before, after = (
            ensemble.core,
            slice(0, ensemble.context),
            slice(ensemble.core.stop, None),
        )
        angle, torque, inputs = (
            np.concatenate([x[run[0], before], *x[run, core], x[run[-1], after]])
            for x in (
                ensemble.angle - level * ensemble.angle.mean(),
                ensemble.torque - level * ensemble.torque.mean(),
                inputs,
            )
        )
        piece = subspace.Piece(torque[lags:-lags], angle, inputs[: -2 * lags])
        return cls(piece, ensemble.context - lags, len(run), ensemble.samples)

    def core(self) -> subspace.Piece:
        """Return the realizations without context, as far as lags reach."""
        first, last = (
            max(0, self.first),
            min(len(self.piece.output), self.first + self.realizations * self.samples),
        )
        output, lagged, inputs = self.piece
        return subspace.Piece(
            output[first:last], lagged[first : last + 2 * self.piece.lags], inputs[first:last]
        )

    def windows(self, centre: int, half: int, past: int) -> list[slice]:
        """Return the window of samples about ``centre`` in each realization.

        The first ``past`` samples are left out, because the inputs before them are not known.
        """
        starts = self.first + centre + self.samples * np.arange(self.realizations)
        bounds = [
            (max(past, int(at) - half), min(len(self.piece.output), int(at) + half + 1))
            for at in starts
        ]
        return [slice(first, last) for first, last in bounds if last > first]


def lasting(response: Array) -> int:
    """Return the number of samples after which a response has nearly ended."""
    area = np.cumsum(np.abs(response))
    return 1 + int(np.searchsorted(area, (1 - FORGOTTEN) * area[-1]))


def grid(samples: int, step: int) -> tuple[list[int], Array]:
    """Return samples a step apart, with both ends, and the share of each in every sample.

    The shares (time, sample of the grid) interpolate linearly.
    """
    count = max(2, 1 + round((samples - 1) / step))
    centres = np.unique(np.round(np.linspace(0, samples - 1, count)).astype(int))
    return centres.tolist(), np.stack(
        [np.interp(np.arange(samples), centres, row) for row in np.eye(len(centres))], axis=1
    )
