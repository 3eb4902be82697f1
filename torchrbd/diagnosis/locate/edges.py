"""Normal equations of features that begin at edges, from differences of neighbouring edges.

Features that begin at two neighbouring edges differ in few rows. So edges are gathered in groups, about as many as each
has members,

    S_e = S_g + D_e,   D_e zero but between the edges of the group

and S_g is whitened and multiplied over all rows, D_e over few.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from torchrbd.diagnosis.rows.regression import Fit


@dataclass(frozen=True)
class _Group:
    """Edges ``members`` (e,) whose steps differ from that of the first of them at some samples, begin to end."""

    members: np.ndarray
    begin: int
    end: int

    @staticmethod
    def of(members: np.ndarray, steps: np.ndarray) -> _Group:
        felt = np.flatnonzero((steps[members[1:]] != steps[members[0]]).any(0))
        return _Group(members, int(felt[0]), int(felt[-1]) + 1) if len(felt) else _Group(members, 0, 0)


@dataclass(frozen=True)
class _Difference:
    """What edges ``members`` (e,) differ by from the first of their group, whitened: (e K, m) at ``rows`` (m,)."""

    members: np.ndarray
    rows: slice
    white: np.ndarray

    def times(self, other: _Difference) -> np.ndarray:
        """Return the products (e K, e' K) with what others differ by."""
        begin = max(self.rows.start, other.rows.start)
        end = max(begin, min(self.rows.stop, other.rows.stop))
        own, its = (x.white[:, begin - x.rows.start : end - x.rows.start] for x in (self, other))
        return own @ its.T


def edge_equations(
    fit: Fit, phi: Mapping[int, np.ndarray], steps: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the normal equations of features that begin at edges, as ``Fit.equations`` does.

    Args:
        fit: whose residual is explained.
        phi: features (K, M) by joint; their coefficients are the same at all joints.
        steps: (E, M) for each edge 0 before it and 1 after.

    Returns:
        Gram (E, K, E, K) given the fit, the same without it, and score (E, K).
    """
    K, E, groups = len(next(iter(phi.values()))), len(steps), _groups(steps)
    first, number = [int(g.members[0]) for g in groups], np.zeros(E, dtype=int)
    for k, g in enumerate(groups):
        number[g.members] = k
    cross, alone, score = np.zeros((fit.X.shape[1], E, K)), np.zeros((E, K, E, K)), np.zeros((E, K))
    for joint, features in phi.items():
        X, e = fit.X[fit.rows.parts[joint]], fit.e[fit.rows.parts[joint]]
        firsts = fit.rows.white((steps[first, None] * features).reshape(len(first) * K, -1), joint)
        cross += (X.T @ firsts.T).reshape(-1, len(first), K)[:, number]
        alone += (firsts @ firsts.T).reshape(len(first), K, -1, K)[number][:, :, number]
        score += (firsts @ e).reshape(-1, K)[number]
        near = [_difference(fit, joint, features, steps, g) for g in groups if g.begin < g.end]
        for k, one in enumerate(near):
            at, count = one.members, len(one.members)
            cross[:, at] += (X[one.rows].T @ one.white.T).reshape(-1, count, K)
            score[at] += (one.white @ e[one.rows]).reshape(count, K)
            mixed = (firsts[:, one.rows] @ one.white.T).reshape(-1, K, count, K)[number]
            alone[:, :, at] += mixed
            alone[at] += mixed.transpose(2, 3, 0, 1)
            for other in near[: k + 1]:
                both = one.times(other).reshape(count, K, -1, K).transpose(0, 2, 1, 3)
                alone[at[:, None], :, other.members] += both
                if other is not one:
                    alone[other.members[:, None], :, at] += both.transpose(1, 0, 3, 2)
    G = fit.posterior.schur(cross.reshape(-1, E * K), alone.reshape(E * K, E * K))
    return G.reshape(E, K, E, K), alone, score


def _groups(steps: np.ndarray) -> Sequence[_Group]:
    """Return edges in groups of steps nearly alike, each by itself where this leaves no fewer numbers to multiply."""
    E, M = steps.shape
    held = steps.sum(1)
    place = (held - held.min()) / max(float(np.ptp(held)), 1.0)
    number = np.floor(place * math.isqrt(E) * (1 - 1e-9))
    found = [_Group.of(np.flatnonzero(number == k), steps) for k in np.unique(number)]
    if len(found) * M + sum(len(g.members) * (g.end - g.begin) for g in found) < E * M:
        return found
    return [_Group(np.array([k]), 0, 0) for k in range(E)]


def _difference(fit: Fit, joint: int, features: np.ndarray, steps: np.ndarray, group: _Group) -> _Difference:
    at, members = slice(group.begin, group.end), group.members[1:]
    change = steps[members, at] - steps[group.members[0], at]
    local = (change[:, None] * features[:, at]).reshape(len(members) * len(features), -1)
    return _Difference(members, *fit.rows.white_part(local, joint, group.begin))
