"""Additional columns given a machine: what they are worth is linear algebra of a few hundred numbers, not of rows.

    S = C'C - V'V,   V = F^-1 X'C,   r = C'(y - X z^)
    log B = 1/2 r'D A^-1 D r - 1/2 log det A,   A = 1 + D S D

X and C are whitened columns of the machine and of the components that are added; F is the root of the machine's
precision, z^ its coefficients, D the prior's standard deviations. See ``gaussian``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import get_lapack_funcs

from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.gaussian import truncated
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.root import forwards

# Steps of amplitudes; gain [nats] that is worth another one; factors of one step; least degrees of freedom.
_STEPS, _LEAST_GAIN, _LEAST, _MOST, _FREEDOM = 20, 0.1, 0.1, 10.0, 1e-6

_potrf, _potri, _potrs = get_lapack_funcs(("potrf", "potri", "potrs"), dtype=np.float64)


class White(NamedTuple):
    """Whitened columns (K, m) at a joint, and the numbers (K,) of their coefficients."""

    joint: int
    at: np.ndarray
    columns: np.ndarray


class Additions:
    """Components given a machine, whose friction may have any sign: ``resistance`` is what signs are worth.

    Args:
        fit: the machine, with its noise.
        extra: what is added to it.

    Attributes:
        std: (K,) prior standard deviations of all coefficients.
    """

    def __init__(self, fit: Likelihood, extra: Sequence[Extra] = ()) -> None:
        at = fit.machine.positive
        self._machine, self.std, self._at = fit.bare, np.zeros(0), dict[int, np.ndarray]()
        self._S, self._r, self._white = np.zeros((0, 0)), np.zeros(0), tuple[White, ...]()
        self._V, self._taken = np.zeros((len(self._machine.gaussian.z), 0)), np.zeros((len(at), 0))
        self._friction = self._machine.gaussian.z[at]
        self._friction_variance = self._machine.gaussian.covariance(at).diagonal()
        self._others, self._given = dict[int, bool](), 0.0
        self._append(extra)

    @staticmethod
    def of(fit: Likelihood) -> Additions:
        """Return the components of a model, from the moments of its rows: ``with_`` cannot add others to these."""
        own, machine, n = Additions(fit), fit.bare.gaussian, fit.machine.n
        own.std = np.concatenate([np.zeros(0), *(e.std for e in fit.extra)])
        own._at = {k: fit.further(k) - n for k in range(len(fit.extra))}
        K = len(own.std)
        cross, own._S, own._r = np.zeros((len(machine.z), K)), np.zeros((K, K)), np.zeros(K)
        for b, first in zip(fit.blocks, machine.blocks, strict=True):
            k = len(b.own) - len(first.own)
            at, there = b.own[:k] - n, b.own[k:]
            # The columns of components that are not in the model are not known, nor needed.
            size = np.where(own.std[at] > 0, own.std[at], 1.0)
            across = b.gram[k:, :k] / size
            cross[np.ix_(there, at)] += across
            own._S[np.ix_(at, at)] += b.gram[:k, :k] / np.outer(size, size)
            own._r[at] += b.scores[:k] / size - machine.z[there] @ across
        own._V = machine.half(cross)
        own._S -= own._V.T @ own._V
        own._taken = machine.solve(cross)[fit.machine.positive]
        return own

    def __len__(self) -> int:
        return len(self._at) + len(self._others)

    def with_(self, extra: Sequence[Extra]) -> Additions:
        """Return these components and others, where none is integrated out."""
        assert not self._others, "components are added to a model before others are integrated out"
        assert self._white or not self._at, "the rows of components that are known from moments are not here"
        other = self._copy(self.std)
        other._append(extra)
        return other

    def without(self, *components: int) -> Additions:
        """Return all components but some: their prior is that they are zero."""
        std = self.std.copy()
        for k in components:
            std[self.at(k)] = 0.0
        return self._copy(std)

    def has(self, k: int) -> bool:
        """Say whether the k-th component is in the model: ``without`` leaves it out."""
        return self._others[k] if k in self._others else bool(self.std[self.at(k)].any())

    def at(self, k: int) -> np.ndarray:
        """Return the numbers of the k-th component's coefficients."""
        return self._at[k]

    def around(self, components: Sequence[int]) -> Additions:
        """Return the same model with all but some components integrated out, as the machine's coefficients are.

            S' = S - W'W,   r' = r - W'u,   W = L^-1 D_o S_o,   u = L^-1 D_o r_o,   L L' = 1 + D_o S_oo D_o

        The index o is of those that are integrated out. Components keep their numbers; these may change no more.
        """
        others = np.concatenate([np.zeros(0, int), *(at for k, at in self._at.items() if k not in components)])
        kept, o = np.concatenate([self._at[k] for k in components]), others[self.std[others] > 0]
        std = self.std[o, None]
        L = np.linalg.cholesky(np.eye(len(o)) + std * self._S[np.ix_(o, o)] * std.T)
        right = std * np.column_stack((self._S[np.ix_(o, kept)], self._r[o], self._taken[:, o].T))
        W, u, T = np.split(forwards(L, right), [len(kept), len(kept) + 1], axis=1)
        other, ends = self._copy(self.std[kept]), np.cumsum([len(self._at[k]) for k in components])
        other._at = dict(zip(components, np.split(np.arange(len(kept)), ends[:-1]), strict=True))
        other._others = self._others | {k: self.has(k) for k in self._at if k not in components}
        other._S, other._r = self._S[np.ix_(kept, kept)] - W.T @ W, self._r[kept] - W.T @ u[:, 0]
        other._given = self._given + 0.5 * float(u[:, 0] @ u[:, 0]) - float(np.log(L.diagonal()).sum())
        other._taken = self._taken[:, kept] - T.T @ W
        other._friction = self._friction - T.T @ u[:, 0]
        other._friction_variance = self._friction_variance + (T**2).sum(0)
        return other

    def _copy(self, std: np.ndarray) -> Additions:
        other = copy(self)
        for name in ("_active", "_root", "_half_inverse", "_inverse", "z", "log_evidence"):
            other.__dict__.pop(name, None)
        other.std = std
        return other

    def _append(self, extra: Sequence[Extra]) -> None:
        gaussian, known, friction = self._machine.gaussian, len(self.std), self._machine.machine.positive
        first = known + np.cumsum([0, *(e.n for e in extra)])
        new = [white for k, e in zip(first.tolist(), extra, strict=False) for white in self._whitened(k, e)]
        K = int(first[-1])
        cross, own, r = np.zeros((len(gaussian.z), K - known)), np.zeros((K, K - known)), np.zeros(K - known)
        for joint, at, C in new:
            cross[np.ix_(gaussian.blocks[joint].own, at - known)] += gaussian.blocks[joint].times(C.T)
            r[at - known] += C @ gaussian.left(joint)
            for there, D in ((one.at, one.columns) for one in (*self._white, *new) if one.joint == joint):
                own[np.ix_(there, at - known)] += D @ C.T
        V = np.concatenate((self._V, gaussian.half(cross)), axis=1)
        own -= V.T @ V[:, known:]
        self._S = np.block([[self._S, own[:known]], [own[:known].T, own[known:]]])
        self._r, self.std = np.concatenate((self._r, r)), np.concatenate((self.std, *(e.std for e in extra)))
        self._V, self._taken = V, np.concatenate((self._taken, gaussian.solve(cross)[friction]), axis=1)
        parts = np.split(np.arange(known, K), first[1:-1] - known)
        self._at = self._at | dict(zip(range(len(self), len(self) + len(extra)), parts, strict=False))
        self._white = (*self._white, *new)

    def _whitened(self, first: int, extra: Extra) -> list[White]:
        """Return a component's columns at all joints that have rows; its coefficients count from the first."""
        found = [(j, *extra.columns(j)) for j in extra.joints if len(self._machine.index[j])]
        noise = self._machine.hyper.noise
        return [White(j, first + at, noise[j].white(columns)) for j, columns, at in found]

    @cached_property
    def _active(self) -> np.ndarray:
        """Numbers of the coefficients that are in the model."""
        return np.flatnonzero(self.std)

    @cached_property
    def _root(self) -> np.ndarray:
        """Cholesky's lower factor of A for the coefficients in the model."""
        at, std = self._active, self.std[self._active]
        L, failed = _potrf(np.eye(len(at)) + std[:, None] * self._S[np.ix_(at, at)] * std, lower=1, clean=1)
        if failed:
            raise np.linalg.LinAlgError("additional components have no positive definite precision")
        return L

    @cached_property
    def _half_inverse(self) -> np.ndarray:
        """A^-1 for the coefficients in the model; only the lower half is valid."""
        return _potri(self._root, lower=1)[0]

    @cached_property
    def _inverse(self) -> np.ndarray:
        """A^-1 (K, K), of a coefficient that is not in the model its prior."""
        found = np.eye(len(self.std))
        if len(self._active):
            half = self._half_inverse
            found[np.ix_(self._active, self._active)] = np.tril(half) + np.tril(half, -1).T
        return found

    @property
    def _variance(self) -> np.ndarray:
        """The diagonal (K,) of A^-1."""
        found = np.ones(len(self.std))
        if len(self._active):
            found[self._active] = self._half_inverse.diagonal()
        return found

    @cached_property
    def z(self) -> np.ndarray:
        """Coefficients (K,) in units of their prior standard deviations, posterior mean."""
        found = np.zeros(len(self.std))
        if len(self._active):
            found[self._active], _ = _potrs(self._root, (self.std * self._r)[self._active], lower=1)
        return found

    @cached_property
    def log_evidence(self) -> float:
        """Log evidence [nats] of the components, against none."""
        own = 0.5 * float(self.z @ (self.std * self._r)) - float(np.log(self._root.diagonal()).sum())
        return self._given + own

    def coefficients(self, k: int) -> np.ndarray:
        """Return the coefficients (K,) of the k-th component in their own units."""
        return self.z[self.at(k)] * self.std[self.at(k)]

    def covariance(self, k: int) -> np.ndarray:
        """Return their posterior covariance (K, K)."""
        at = self.at(k)
        return self._inverse[np.ix_(at, at)] * np.outer(self.std[at], self.std[at])

    def evidence_for(self, k: int) -> float:
        """Return the log evidence for the k-th component given the others: the Savage-Dickey density ratio."""
        at = self.at(k)
        after, z = self._inverse[np.ix_(at, at)], self.z[at]
        return 0.5 * float(np.linalg.slogdet(after)[1] + z @ np.linalg.solve(after, z))

    @property
    def friction(self) -> np.ndarray:
        """Viscous and both Coulomb coefficients of the machine's joints given the components, (n, 3)."""
        z, machine = self._machine.gaussian.z.copy(), self._machine.machine
        z[machine.positive] = self._friction - self._taken @ (self.z * self.std)
        return machine.friction.of(z, self._machine.hyper)

    @property
    def resistance(self) -> float:
        """Log evidence [nats] that friction resists: of the signs of the machine's own coefficients, one by one."""
        taken = self._taken * self.std
        variance = self._friction_variance + ((taken @ self._inverse) * taken).sum(1)
        mean = self._friction - taken @ self.z
        return float(truncated(mean, np.sqrt(np.maximum(variance, 0.0)), range(len(mean))))

    def sized(self, sizes: Mapping[int, np.ndarray]) -> Additions:
        """Return the same components; some have other prior standard deviations (K,), by their number."""
        std = self.std.copy()
        for k, size in sizes.items():
            std[self.at(k)] = size
        return self._copy(std)

    def rescaled(self, ratios: Mapping[int, float]) -> Additions:
        """Return the same components with other prior sizes, times ``ratios`` by their number."""
        std = self.std.copy()
        for k, ratio in ratios.items():
            std[self.at(k)] *= ratio
        return self._copy(std)

    def likeliest(self, components: Sequence[int]) -> Additions:
        """Return the same model; some components have the amplitudes of greatest evidence.

            a^2 <- a^2 sum z^2 / (K - sum var z)

        Where a step lowers the evidence, one of expectation-maximisation is taken instead.

        Source: MacKay, "Bayesian Interpolation", Neural Computation 1992, eq. 4.8.
        """
        now = self
        for _ in range(_STEPS if components else 0):
            variance = now._variance
            each = [(now.z[at], variance[at]) for at in map(now.at, components)]
            fixed = [(z @ z) / max(len(z) - var.sum(), _FREEDOM) for z, var in each]
            then = now._by(components, fixed)
            if then.log_evidence < now.log_evidence:
                then = now._by(components, [(z @ z + var.sum()) / len(z) for z, var in each])
            if then.log_evidence < now.log_evidence + _LEAST_GAIN:
                break
            now = then
        return now

    def _by(self, components: Sequence[int], squares: Sequence[float]) -> Additions:
        """Return the same components, the prior variances of some times ``squares``, within the limits of one step."""
        ratios = np.clip(np.sqrt(squares), _LEAST, _MOST).tolist()
        return self.rescaled(dict(zip(components, ratios, strict=True)))
