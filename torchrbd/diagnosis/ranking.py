"""Which physics does the likelihood ask for? Every effect at every place, by its log evidence.

A hypothesis is an effect at a place. What it leaves open (nonlinear shapes, the stretch of time in which it acts, its
size) is averaged over before it is compared, so that the number of possibilities is paid for:

    log B = log mean_(shape, window, size) p(tau | base, effect) / p(tau | base)
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.linalg import solve_triangular

from torchrbd.inference.data.columns import Candidate
from torchrbd.likelihood.gaussian import Addition, added, mixture
from torchrbd.likelihood.likelihood import Extra, Likelihood, learn
from torchrbd.likelihood.machine import Machine
from torchrbd.likelihood.prior import coefficient_std
from torchrbd.likelihood.rows import Rows
from torchrbd.physics import Effect, Site, Window
from torchrbd.physics.registry import effect

# The machine has these already.
ORDINARY = ("viscous_friction", "coulomb_friction", "asymmetric_coulomb_friction")
# A hypothesis whose odds are above this is adopted before the others are ranked once more; at most so many.
_SURE, _MOST_ADOPTED = 9.0, 8
# Windows of time, counted in blocks.
_MOST_EDGES = 33


@dataclass(frozen=True)
class Hypothesis:
    """An effect at a place, and what the data say for it.

    Attributes:
        candidate: the effect with the shape, and window, of the greatest evidence.
        log_evidence: against the base, averaged over shapes, windows and sizes, in nats.
        coefficients, std: (K,) posterior of its coefficients.
        tried: shapes and windows that were averaged over.
    """

    candidate: Candidate
    log_evidence: float
    coefficients: np.ndarray
    std: np.ndarray
    tried: int

    @property
    def name(self) -> tuple[str, Site]:
        """Effect and place, whatever the window."""
        return self.candidate.effect.id, replace(self.candidate.site, window=None)


def screened(fit: Likelihood, rows: Rows, effects: Iterable[Effect]) -> list[Hypothesis]:
    """Return every effect at every place beside a fit, greatest evidence first.

    Args:
        fit: the base.
        rows: its rows, whose signals carry its load and friction.
        effects: what may be there.
    """
    found: list[Hypothesis] = []
    timed = [e for e in effects if not e.sites(rows.columns.robot)]
    for e in (e for e in effects if e.id not in ORDINARY and e not in timed):
        for site in e.sites(rows.columns.robot):
            if e.id == "time_delay" and site.joint is None and rows.n_dof > 1:
                continue
            if e.whole_robot or rows.seen[site.joint or 0]:
                shapes = e.shapes(rows.columns.scale(site)) if e.first_order is None else (e.first_order,)
                one = _averaged(fit, rows, [rows.columns.candidate(e, site, shape) for shape in shapes])
                if one is not None:
                    found.append(one)
    for e in timed:
        found += _in_windows(fit, rows, e)
    return sorted(found, key=lambda h: -h.log_evidence)


def _averaged(fit: Likelihood, rows: Rows, candidates: Sequence[Candidate]) -> Hypothesis | None:
    """Return the evidence of an effect at a place, averaged over its shapes."""
    parts = [(c, F) for c in candidates if np.isfinite(F := rows.features(c)).all() and F.any()]
    if not parts:
        return None
    S, r = fit.beside(parts[0][0].place, np.concatenate([F for _, F in parts]))
    found, first = [], 0
    for c, F in parts:
        here = slice(first, first := first + len(F))
        found.append(_sized(fit, c, F, S[here, here], r[here]))
    whole = mixture(found)
    best = max(range(len(found)), key=lambda k: found[k].log_evidence)
    return Hypothesis(parts[best][0], whole.log_evidence, whole.mean, whole.std, len(candidates))


def _sized(fit: Likelihood, candidate: Candidate, F: np.ndarray, S: np.ndarray, r: np.ndarray) -> Addition:
    """Return the evidence of a candidate, averaged over its size."""
    std, scales = coefficient_std(candidate, F, fit.machine.torque_rms)
    return mixture([added(S, r, std * k, candidate.effect.prior.positive) for k in scales])


def _in_windows(fit: Likelihood, rows: Rows, e: Effect) -> list[Hypothesis]:
    """Return the evidence of an effect on every link, averaged over stretches of time.

    The columns of a stretch are those of all time, zero outside: their moments are sums over its blocks.
    """
    found = []
    for k, name in enumerate(rows.recordings):
        inside = rows.recording == k
        if not inside.any():
            continue
        whole = Window(name)
        edges = np.unique(rows.block[inside])
        step = math.ceil(len(edges) / (_MOST_EDGES - 1))
        several = len(rows.recordings) > 1
        for site in e.sites(rows.columns.robot, (whole,)):
            candidate = rows.columns.candidate(e, site, {})
            one = _best_window(fit, rows, candidate, edges[::step], several)
            if one is not None:
                found.append(one)
    return found


def _best_window(
    fit: Likelihood, rows: Rows, candidate: Candidate, edges: np.ndarray, several: bool
) -> Hypothesis | None:
    """Average over all stretches between edges; over the whole recording too where there are several."""
    F = rows.features(candidate)
    std, scales = coefficient_std(candidate, F, fit.machine.torque_rms)
    std = std * scales[1]
    n_blocks, K, P = len(edges), len(F), len(fit.gaussian.z)
    cross, gram, score = np.zeros((n_blocks, P, K)), np.zeros((n_blocks, K, K)), np.zeros((n_blocks, K))
    inside = (rows.block >= edges[0]) & (rows.recording == rows.recordings.index(candidate.site.window.recording))  # type: ignore[union-attr]
    for j, index in enumerate(fit.index):
        if not len(index):
            continue
        C = fit.hyper.noise[j].white(F[:, j], index)
        b = fit.gaussian.blocks[j]
        number = np.searchsorted(edges, rows.block[index], side="right") - 1
        for k in np.unique(number[inside[index]]):
            at = (number == k) & inside[index]
            cross[k, b.own] += b.X[:, at] @ C[:, at].T
            gram[k] += C[:, at] @ C[:, at].T
            score[k] += C[:, at] @ fit.gaussian.left[j][at]
    V = solve_triangular(fit.gaussian.L, cross.transpose(1, 0, 2).reshape(P, -1), lower=True, check_finite=False)
    V = V.reshape(P, n_blocks, K)
    # Sums over windows from those up to each edge.
    V, gram, score = (np.concatenate((np.zeros_like(x[:1]), np.cumsum(x, 0))) for x in (V.transpose(1, 0, 2), gram, score))
    found: list[tuple[Addition, int, int]] = []
    for begin in range(n_blocks):
        for end in range(begin + 1, n_blocks + 1):
            if end - begin == n_blocks and not several:
                continue
            U = V[end] - V[begin]
            S, r = gram[end] - gram[begin] - U.T @ U, score[end] - score[begin]
            found.append((added(S, r, std, candidate.effect.prior.positive), begin, end))
    if not found:
        return None
    total = mixture([a for a, *_ in found])
    _, begin, end = max(found, key=lambda one: one[0].log_evidence)
    t = rows.t[inside]
    times = [float(rows.t[(rows.block >= e) & inside].min()) for e in edges] + [float(t.max())]
    window = Window(candidate.site.window.recording, times[begin], times[end])  # type: ignore[union-attr]
    best = rows.columns.candidate(candidate.effect, replace(candidate.site, window=window), {})
    return Hypothesis(best, total.log_evidence, total.mean, total.std, len(found))


def learnt(rows: Rows, held: frozenset[str] = frozenset()) -> tuple[Likelihood, Rows]:
    """Return the likelihood of ordinary physics, and the rows whose signals carry its load and friction."""
    fit = learn(Machine(rows, held))
    return fit, rows.around(fit.pi, fit.hyper.friction, fit.hyper.rest_width)
