"""Joint smoothing of states and parameters: for recordings whose position noise would bias a fit on filtered states."""

from torchrbd.inference.smoothing.smooth import smooth, smoothable
from torchrbd.inference.smoothing.smoother import StateSmoother

__all__ = ["StateSmoother", "smooth", "smoothable"]
