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
        core, context = ensemble.core, ensemble.context
        level = 0.0 if ensemble.mean_subtracted else 1.0

        def line(values: Array) -> Array:
            ends = values[run[0], :context], values[run[-1], core.stop :]
            return np.concatenate([ends[0], *values[run, core], ends[1]])

        angle, torque = (
            line(each - level * each.mean()) for each in (ensemble.angle, ensemble.torque)
        )
        piece = subspace.Piece(torque[lags:-lags], angle, line(inputs)[: -2 * lags])
        return cls(piece, context - lags, len(run), ensemble.samples)

    def core(self) -> subspace.Piece:
        """Return the realizations without context, as far as lags reach."""
        first, last = max(0, self.first), self.first + self.realizations * self.samples
        last = min(len(self.piece.output), last)
        output, lagged, inputs = self.piece
        lagged = lagged[first : last + 2 * self.piece.lags]
        return subspace.Piece(output[first:last], lagged, inputs[first:last])

    def windows(self, centre: int, half: int, past: int) -> list[slice]:
        """Return the window of samples about ``centre`` in each realization.

        The first ``past`` samples are left out, because the inputs before them are not known.
        """
        middle = self.first + centre + self.samples * np.arange(self.realizations)
        first = np.maximum(past, middle - half)
        last = np.minimum(len(self.piece.output), middle + half + 1)
        return [
            slice(*pair)
            for pair in zip(first.tolist(), last.tolist(), strict=True)
            if pair[1] > pair[0]
        ]


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
    shares = [np.interp(np.arange(samples), centres, unit) for unit in np.eye(len(centres))]
    return centres.tolist(), np.stack(shares, axis=1)
