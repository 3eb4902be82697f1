"""Noise made white: coloured noise less what its own past predicts.

    e(k) = (r(k) - sum_i a_i r(k - i)) / s,   a by Yule and Walker

Source: Prais-Winsten or Cochrane-Orcutt for one regression.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_toeplitz

ORDER = 4
# A sample of torque is believed to this part of the joint's RMS at best: what is smaller does not matter, and simulated
# torques without noise would make it significant.
LEAST_NOISE = 2e-3
# White floor of the spectrum: what whitening amplifies at most.
_FLOOR = 0.02

Noise = tuple[np.ndarray, np.ndarray]
"""Filters (n, ORDER) and scale (n,) of joints, the latter in [N m] or [N]."""


def whitened(A: np.ndarray, index: np.ndarray, a: np.ndarray, scale: float) -> np.ndarray:
    """Return signals (..., M) less what their predecessors predict, at some samples, over a scale.

    Args:
        A: the signals.
        index: (m,) samples, ORDER of which come before each.
        a: (ORDER,) predictor.
        scale: of the noise.
    """
    M = A.shape[-1]
    out = A[..., ORDER:].astype(float)
    for i, a_i in enumerate(a, start=1):
        if a_i:
            out -= a_i * A[..., ORDER - i : M - i]
    return out.take(index - ORDER, axis=-1) / scale


def autocovariance(a: np.ndarray, scale: float) -> np.ndarray:
    """Return the autocovariance (ORDER + 1,) of noise with a predictor (ORDER,) that errs by ``scale``."""
    lags = range(len(a) + 1)
    A = np.eye(len(a) + 1)
    for k in lags:
        for i, a_i in enumerate(a, start=1):
            A[k, abs(k - i)] -= a_i
    return np.linalg.solve(A, np.eye(len(a) + 1)[0]) * scale**2


def relief(weight: np.ndarray, index: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return what whitened rows (m,) count whose samples have weights w (M,), 0 to 1.

    A sample of weight w is noise and something unknown, 1/w^2 - 1 times the variance c_0 of the noise. So the variance
    of a whitened row of weighted samples, in units of that of an unweighted row, is

        v(k) = sum_il b_i b_l w(k - i) w(k - l) c_|i-l| + c_0 sum_i b_i^2 (1 - w(k - i)^2),   b = (1, -a)

    Where a predecessor counts little, the noise is not predicted, and v > 1: the row counts 1 / sqrt(v).
    """
    b = np.concatenate(([1.0], -np.asarray(a)))
    c = autocovariance(a, 1.0)
    w = np.stack([weight[index - i] for i in range(len(b))])
    C = c[np.abs(np.subtract.outer(np.arange(len(b)), np.arange(len(b))))]
    bw = b[:, None] * w
    v = np.einsum("im,il,lm->m", bw, C, bw) + c[0] * (b[:, None] ** 2 * (1 - w**2)).sum(0)
    return 1.0 / np.sqrt(np.maximum(v, 1.0))


def predictor(r: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return the predictor (ORDER,) of a leftover (M,) from its predecessors."""
    c = np.array([np.mean(r[index] * r[index - i]) for i in range(ORDER + 1)])
    c[0] = (1 + _FLOOR) * max(c[0], np.mean(r[index - ORDER] ** 2), 1e-300)
    return solve_toeplitz(c[:-1], c[1:])
