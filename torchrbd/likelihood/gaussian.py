"""The linear-Gaussian posterior, of normal equations or whitened rows, and the evidence of columns added to it.

In coordinates z ~ N(0, 1) and with whitened rows y = X z + n,

    H = X'X + 1 = F F',   z^ = H^-1 X'y,   log p(y) = -1/2 (y'y - z^'X'y) - log det F + const

Additional columns C with coefficients w ~ N(0, D^2) have, given these, precision S = C'C - V'V with V = F^-1 X'C and
score r = C'(y - X z^). They raise the log marginal likelihood by

    log B = 1/2 r'D (1 + D S D)^-1 D r - 1/2 log det(1 + D S D)

which includes the Occam factor of a proper prior: MacKay, "Information Theory, Inference, and Learning Algorithms"
(2003), ch. 28. A coefficient that cannot be negative has a half-normal prior: B is then multiplied by its posterior
probability of being positive, over that of the prior.

All linear fits use ``Posterior``: those of block statistics, of whitened rows, and with some rows left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr

from torchrbd.likelihood.block import Block
from torchrbd.likelihood.root import ROUNDING, Eliminated, Root, forwards

# Sweeps over the sites of truncated coefficients, and the least fraction of its variance that a truncation keeps.
_SWEEPS, _LEAST_VARIANCE = 8, 1e-6
# Directions of a joint's columns below this are dominated by rounding.
_LEAST_DIRECTION = 1e-3
# Largest factor by which one step may change the mean square of a prior.
_STEP = 10.0


@dataclass(frozen=True)
class Quadratic:
    """A log density, -1/2 z'P z + s'z + c: precision P (N, N), shift s (N,), constant c."""

    precision: np.ndarray
    shift: np.ndarray
    constant: float


@dataclass(frozen=True)
class Addition:
    """Additional columns, given a posterior, (*batch) alternatives of them.

    Attributes:
        log_evidence: (*batch) in nats.
        mean, std: (*batch, K) of their coefficients.
    """

    log_evidence: np.ndarray
    mean: np.ndarray
    std: np.ndarray


class Posterior:
    """The posterior N(z^, H^-1) of coefficients z (P,) from their normal equations H z = h, prior included.

    Args:
        H: (P, P) precision.
        h: (P,) shift.
        rounding: fraction of its diagonal that is added to H.

    Attributes:
        root: of the precision.
        z: (P,) mean.

    Raises:
        LinAlgError: H is not positive definite.
    """

    def __init__(self, H: np.ndarray, h: np.ndarray, rounding: float = ROUNDING) -> None:
        self._solve(Root(np.arange(len(H)), H, rounding=rounding), h)
        self.H = H

    def _solve(self, root: Root, h: np.ndarray) -> None:
        self.root, self.h = root, h
        self.z = self.solve(h)

    def half(self, B: np.ndarray) -> np.ndarray:
        """Return F^-1 B for B (P, ...), F the root of the precision."""
        return self.root.half(B)

    def solve(self, B: np.ndarray) -> np.ndarray:
        """Return H^-1 B for B (P, ...)."""
        return self.root.solve(B)

    def schur(self, cross: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Return the Schur complement of additional columns, with products ``own`` (K, K), and ``cross`` (P, K) with X.

        S = C'C - V'V,   V = F^-1 X'C
        """
        V = self.half(cross)
        return own - V.T @ V

    def first(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Return precision (k, k) and shift (k,) of the first k coefficients, all others integrated out.

        They must be shared ones.
        """
        S, shift = self.root.left, self.h[self.root.shared].copy()
        for own, L, X, met in self.root.local:
            shift[met] -= X.T @ forwards(L, self.h[own])
        across = np.linalg.solve(S[k:, k:], np.column_stack((S[k:, :k], shift[k:])))
        P = S[:k, :k] - S[:k, k:] @ across[:, :k]
        return 0.5 * (P + P.T), shift[:k] - S[:k, k:] @ across[:, k]

    def covariance(self, index: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return the posterior covariance of some coefficients, (K, K)."""
        return self.root.covariance(np.asarray(index, dtype=int))

    def against(
        self, index: Sequence[int] | np.ndarray, value: np.ndarray | float = 0.0, sums: np.ndarray | None = None
    ) -> float:
        """Return the log evidence against a value of coefficients (K,): the Savage-Dickey density ratio.

        With ``sums`` (S, K) it is that of S weighted sums of them.
        """
        W = np.eye(len(index)) if sums is None else sums
        before, after, x = W @ W.T, W @ self.covariance(index) @ W.T, np.broadcast_to(value, len(W))
        m, log_ratio = W @ self.z[list(index)] - x, np.linalg.slogdet(after)[1] - np.linalg.slogdet(before)[1]
        return 0.5 * float(log_ratio + m @ np.linalg.solve(after, m) - x @ np.linalg.solve(before, x))


class Gaussian(Posterior):
    """The posterior of coefficients z (P,), given one block of whitened rows per joint.

    What each block says of the coefficients that it shares is remembered there, so that another model costs only the
    blocks that are new in it.

    Args:
        blocks: one per joint.
        n: number of coefficients P.
        first: log prior density of the first of them; the others have N(0, 1).
        sites: factors (3, P) that multiply the prior, see ``nonnegative``.
        local: per block, the indices of the coefficients that only this block has, none of them among the first; if
            not given, none are known.

    Attributes:
        log_evidence: of the rows, in units of their noise.
    """

    def __init__(
        self,
        blocks: Sequence[Block],
        n: int,
        first: Quadratic | None = None,
        sites: np.ndarray | None = None,
        local: Sequence[np.ndarray] = (),
    ) -> None:
        self.blocks, self._first, self._sites = tuple(blocks), first, np.zeros((3, n)) if sites is None else sites
        self._used, self._left = dict[int, float](), dict[int, np.ndarray]()
        inside = [np.zeros(len(b.own), bool) for b in blocks]
        outside = np.ones(n, bool)
        for j, own in enumerate(local):
            alone = np.zeros(n, bool)
            alone[own] = True
            inside[j] = alone[blocks[j].own]
            outside[blocks[j].own[inside[j]]] = False
        number, shared = np.cumsum(outside) - 1, np.flatnonzero(outside)
        H, parts = np.diag(1.0 + self._sites[0, shared]), list[tuple[np.ndarray, Eliminated]]()
        h, constant = self._sites[1].copy(), float(self._sites[2].sum())
        if first is not None:
            k = len(first.shift)
            H[:k, :k] += first.precision - np.eye(k)
            h[:k] += first.shift
            constant += first.constant
        for b, alone in zip(self.blocks, inside, strict=True):
            own, met = b.own[alone], number[b.own[~alone]]
            kept, found = b.eliminated(alone, 1.0 + self._sites[0, own])
            h[b.own] += b.scores
            H[np.ix_(met, met)] += kept
            if local:
                parts.append((own, found._replace(met=met[found.met])))
        self._solve(Root(shared, H, parts), h)
        power = sum(b.power for b in self.blocks)
        self.log_evidence = constant - 0.5 * (power - float(h @ self.z)) - self.root.log_det

    @cached_property
    def H(self) -> np.ndarray:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The precision (P, P), prior included."""
        H = np.diag(1.0 + self._sites[0])
        for b in self.blocks:
            H[np.ix_(b.own, b.own)] += b.gram
        if self._first is not None:
            k = len(self._first.shift)
            H[:k, :k] += self._first.precision - np.eye(k)
        return H

    def left(self, joint: int) -> np.ndarray:
        """Return the whitened residual (m,) of a joint."""
        if joint not in self._left:
            b = self.blocks[joint]
            self._left[joint] = b.y - b.explained(self.z[b.own])
        return self._left[joint]

    def among(self, kept: np.ndarray) -> Gaussian:
        """Return the posterior of a model with only some of the coefficients; all others are zero."""
        number, first = np.full(len(self.z), -1), self._first or Quadratic(np.zeros((0, 0)), np.zeros(0), 0.0)
        number[kept] = np.arange(len(kept))
        blocks = [b.some(number[b.own] >= 0, number[b.own]) for b in self.blocks]
        inside = kept[kept < len(first.shift)]
        # At zero, a site is its constant.
        constant = first.constant + float(np.delete(self._sites[2], kept).sum())
        first = Quadratic(first.precision[np.ix_(inside, inside)], first.shift[inside], constant)
        local = [number[one.own][number[one.own] >= 0] for one in self.root.local]
        return Gaussian(blocks, len(kept), first, self._sites[:, kept], local)

    def without(self, rows: Sequence[np.ndarray]) -> Gaussian:
        """Return the posterior without some rows of each block, by their numbers (k,)."""
        blocks = [b.without(own) for b, own in zip(self.blocks, rows, strict=True)]
        return Gaussian(blocks, len(self.z), self._first, self._sites, [one.own for one in self.root.local])

    def used(self, joint: int) -> float:
        """Return the degrees of freedom that the fit takes from a joint's rows."""
        if joint not in self._used:
            b = self.blocks[joint]
            self._used[joint] = float((self.covariance(b.own) * b.gram).sum())
        return self._used[joint]

    def rms(self, index: np.ndarray) -> float:
        """Return the posterior root mean square of some coefficients, one before the data; 0 if there are none.

        It is the expectation-maximisation step for the standard deviation of their prior.
        """
        if not len(index):
            return 0.0
        power = float(np.mean(self.z[index] ** 2 + self.covariance(index).diagonal()))
        return math.sqrt(min(max(power, 1.0 / _STEP), _STEP))

    def dispersion(self, joint: int, part: np.ndarray, errors: np.ndarray | None = None) -> float:
        """Return the scatter of a joint's scores over parts of its rows, numbered (m,), divided by that of white rows.

        With scores g_b = X_b'e_b in coordinates in which X'X = 1, E[sum_b |g_b|^2] is the number of directions if rows
        are independent, and larger if errors are correlated: the ratio of the sandwich estimator (White, "Maximum
        Likelihood Estimation of Misspecified Models", Econometrica 1982).

        Args:
            joint: its index.
            part: (m,) number of the part of each row, ascending.
            errors: (m,) in place of the whitened residual.
        """
        b, e = self.blocks[joint], self.left(joint) if errors is None else errors
        if not len(e):
            return 1.0
        size = np.sqrt(np.maximum(b.gram.diagonal(), 1e-300))
        values, vectors = np.linalg.eigh(b.gram / size / size[:, None])
        kept = values > _LEAST_DIRECTION
        coordinates = vectors[:, kept] / np.sqrt(values[kept]) / size[:, None]
        scores = np.add.reduceat(b.X * e, np.flatnonzero(np.diff(part, prepend=-1)), axis=1).T @ coordinates
        return float((scores**2).sum() / kept.sum() / np.mean(e**2))

    def precision_and_score(self, columns: dict[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return precision S (K, K) and score r (K,) of whitened columns, (K, m) by joint."""
        S, r = self.precisions_and_scores({joint: C[None] for joint, C in columns.items()})
        return S[0], r[0]

    def precisions_and_scores(self, columns: dict[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return S (G, K, K) and r (G, K) of alternatives of whitened columns, (G, K, m) by joint, each by itself."""
        G, K, _ = next(iter(columns.values())).shape
        cross, own, r = np.zeros((len(self.z), G * K)), np.zeros((G, K, K)), np.zeros((G, K))
        for joint, C in columns.items():
            b = self.blocks[joint]
            cross[b.own] += b.times(C.reshape(G * K, -1).T)
            own += C @ C.swapaxes(1, 2)
            r += C @ self.left(joint)
        V = self.half(cross).T.reshape(G, K, -1)
        return own - V @ V.swapaxes(1, 2), r


def added(S: np.ndarray, r: np.ndarray, std: np.ndarray, positive: Sequence[int] = ()) -> Addition:
    """Return the log evidence of additional columns with precision S (*batch, K, K) and score r (*batch, K).

    Args:
        S, r: from ``Gaussian.precision_and_score``.
        std: (*batch, K) prior standard deviations of the coefficients.
        positive: indices of those that cannot be negative.

    Raises:
        LinAlgError: S is not positive definite.
    """
    inverse, log_det = _inverse(np.eye(S.shape[-1]) + std[..., :, None] * S * std[..., None, :])
    mean = std * (inverse @ (std * r)[..., None])[..., 0]
    spread = std * np.sqrt(np.maximum(np.diagonal(inverse, axis1=-2, axis2=-1), 0.0))
    log_evidence = 0.5 * (mean * r).sum(-1) - 0.5 * log_det
    return Addition(log_evidence + truncated(mean, spread, positive), mean, spread)


def _inverse(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the inverses (*batch, K, K) of precisions and the logs of their determinants (*batch,).

    Raises:
        LinAlgError: one is not positive definite.
    """
    if A.shape[-1] == 1:
        # Most hypotheses have one coefficient: much quicker than one matrix after the other.
        inverse, positive = 1.0 / A, A[..., 0, 0] > 0
        log_det = np.log(np.where(positive, A[..., 0, 0], 1.0))
    else:
        inverse, (sign, log_det) = np.linalg.inv(A), np.linalg.slogdet(A)
        positive = sign > 0
    if not positive.all():
        raise np.linalg.LinAlgError("columns given a posterior have no positive definite precision")
    return inverse, log_det


def truncated(mean: np.ndarray, std: np.ndarray, positive: Sequence[int]) -> np.ndarray:
    """Return the log evidence of the signs that coefficients (*batch, K) must have, (*batch,) in nats.

    For each, the log of the posterior probability of a positive value over the prior's.
    """
    mean, std = mean[..., list(positive)], std[..., list(positive)]
    ratio = np.divide(mean, std, out=np.zeros_like(std), where=std > 0)
    return np.where(std > 0, math.log(2.0) + log_ndtr(ratio), 0.0).sum(-1)


def nonnegative(mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return Gaussian sites (3, K) that approximate the truncation of coefficients (K,) which cannot be negative.

        2 [z >= 0] ~ exp(c + s z - 1/2 p z^2),   with p, s, c in this order

    Each makes integral, mean and variance of its coefficient those of the truncated density, given the other sites. The
    factor 2 is that of a half-normal prior over the normal one.

    Source: Minka, "Expectation Propagation for Approximate Bayesian Inference", UAI 2001, sec. 3.
    """
    m, C = mean.copy(), covariance.copy()
    precision, shift, constant = sites = np.zeros((3, len(m)))
    for _ in range(_SWEEPS):
        for k in range(len(m)):
            rest = 1.0 / C[k, k] - precision[k] if C[k, k] > 0 else 0.0
            if rest <= 0:
                continue
            std, centre = rest**-0.5, (m[k] / C[k, k] - shift[k]) / rest
            kept = float(log_ndtr(centre / std))
            ratio = math.exp(_log_normal(centre / std) - kept)
            variance = std**2 * max(1.0 - ratio * (ratio + centre / std), _LEAST_VARIANCE)
            more = max(1.0 / variance - rest, 0.0) - precision[k]
            turn = (centre + std * ratio) / variance - centre * rest - shift[k]
            precision[k] += more
            shift[k] += turn
            with_it = rest + precision[k]
            exponent = (centre * rest + shift[k]) ** 2 / with_it - centre**2 * rest
            constant[k] = math.log(2.0) + kept + 0.5 * math.log(with_it / rest) - 0.5 * exponent
            column = C[:, k].copy()
            C -= np.outer(column, column) * (more / (1.0 + more * column[k]))
            m += column * ((turn - more * m[k]) / (1.0 + more * column[k]))
    return sites


def _log_normal(x: float) -> float:
    return -0.5 * x * x - 0.5 * math.log(2.0 * math.pi)
