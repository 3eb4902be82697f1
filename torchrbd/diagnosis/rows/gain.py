"""How much better one model predicts left-out blocks than another.

With v the left-out mean squared error of a joint's m whitened rows, one model's gain over another is

    G = sum_j m_j / 2 log(v_j / v'_j) = sum_b d_b,   d_b = sum_j (e_jb - e'_jb) / (2 u_j),
    u = (v - v') / log(v / v')

in log-likelihood units: u, the logarithmic mean, spreads the gain over the blocks b. Their scatter measures chance for
what acts all the time. What acts now and then gains in few blocks and scatters widely. For that, the gain without the
best two blocks shows that it was no accident.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from torchrbd.diagnosis.decisions import DECISIONS

_BEST = 2
# Log-likelihood units beyond which odds count as equal.
_LONGEST = 50.0


@dataclass(frozen=True)
class Gain:
    """A gain in log-likelihood units.

    ``total`` summed over blocks; ``std`` its standard error from the scatter over blocks; ``repeated`` the total
    without the two blocks that gain most.
    """

    total: float
    std: float
    repeated: float

    @property
    def t(self) -> float:
        """Return the gain in standard errors."""
        return self.total / self.std if self.std > 0 else 0.0


def gain(before: np.ndarray, after: np.ndarray, counts: np.ndarray) -> Gain:
    """Return the gain of left-out errors ``after`` over ``before``, both (B, n); ``counts`` (n,) rows of each joint."""
    seen = counts > 0
    old, new = before.sum(0)[seen], after.sum(0)[seen]
    ratio = np.log(old / new)
    close = np.abs(ratio) < 1e-6
    mean = np.where(close, old, (old - new) / np.where(close, 1.0, ratio)) / counts[seen]
    difference = np.sort(0.5 * ((before - after)[:, seen] / mean).sum(1))
    std = float(difference.std(ddof=1) * len(difference) ** 0.5) if len(difference) > 1 else np.inf
    return Gain(float(difference.sum()), std, float(difference[:-_BEST].sum()))


def accepted(worth: Gain) -> bool:
    """Say whether a gain is enough, and no accident of a few blocks."""
    d = DECISIONS
    return worth.total > d.spring_gain and (worth.t > d.spring_t or worth.repeated > d.spring_repeated)


def odds(lead: Gain) -> float:
    """Return how many times as probable a model is as another that has a lead over it on left-out blocks.

        o = max(exp(-G), min(exp(-t^2 / 2), exp(-R))),   t = G / std(G)

    The ratio is that of the likelihoods, but no larger than the blocks support: by their scatter, or by the lead R
    without the best two of them.
    """
    scatter = min(math.exp(-0.5 * max(lead.t, 0.0) ** 2), math.exp(-max(lead.repeated, 0.0)))
    return max(math.exp(min(-lead.total, _LONGEST)), scatter)
