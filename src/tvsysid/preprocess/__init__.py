"""From a recording to an ensemble: decimate, segment, subtract the mean."""

from tvsysid.preprocess.decimate import decimate
from tvsysid.preprocess.segment import segment, subtract_mean

__all__ = ["decimate", "segment", "subtract_mean"]
