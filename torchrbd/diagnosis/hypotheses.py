"""Every effect at every place, beside a likelihood: the evidence of each, averaged over what it leaves open.

    log B = log mean_(shape, window, size) p(tau | base, effect) / p(tau | base)

so that the number of shapes and stretches of time that were tried is paid for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from torchrbd.likelihood.columns import Candidate
from torchrbd.likelihood.gaussian import added
from torchrbd.likelihood.likelihood import Extra, Likelihood
from torchrbd.likelihood.machine import ORDINARY_EFFECTS
from torchrbd.likelihood.rows import Rows
from torchrbd.likelihood.shapes import varied
from torchrbd.likelihood.sizes import coefficient_std
from torchrbd.physics import Effect, Site, Window

# The machine has these already, and one offset of the clocks for all joints.
ORDINARY = (*ORDINARY_EFFECTS, "coulomb_friction")
# Edges of the stretches of time in which something may act, spread over a recording.
_MOST_EDGES = 33
# What is there for more than this part of a recording is there always.
_MOST_OF_TIME = 0.9
# Points between a shape's neighbours on the grid.
_FINE = 9


@dataclass(frozen=True)
class Hypothesis:
    """An effect at a place, and what the data say for it.

    Attributes:
        candidate: the effect with the shape, or window, of the greatest evidence.
        log_evidence: against the base, in nats.
        coefficients, std: (K,) posterior of its coefficients.
        scale: multiple of their prior that has the greatest evidence.
        tried: shapes, or windows, that were averaged over.
    """

    candidate: Candidate
    log_evidence: float
    coefficients: np.ndarray
    std: np.ndarray
    scale: float
    tried: int

    @property
    def name(self) -> tuple[str, Site]:
        """Effect and place, whatever its window."""
        return self.candidate.effect.id, replace(self.candidate.site, window=None)

    def extra(self, fit: Likelihood, rows: Rows) -> Extra:
        """Return its columns, as a model takes them."""
        std, _ = _believed(fit, rows, self.candidate)
        return Extra(self.candidate.place, rows.features(self.candidate), std * self.scale)


def screened(fit: Likelihood, rows: Rows, effects: Sequence[Effect]) -> list[Hypothesis]:
    """Return every effect at every place beside a fit, greatest evidence first.

    Args:
        fit: the base.
        rows: its rows, whose signals carry its load and friction.
        effects: what may be there.
    """
    robot = rows.columns.robot
    found: list[Hypothesis | None] = []
    for e in (e for e in effects if e.id not in ORDINARY):
        places = e.sites(robot)
        if not places:
            found += _in_windows(fit, rows, e)
        for site in places:
            if _may_be(e, site, rows):
                shapes = e.shapes(rows.columns.scale(site)) if e.first_order is None else (e.first_order,)
                found.append(_averaged(fit, rows, [rows.columns.candidate(e, site, shape) for shape in shapes]))
    return sorted((h for h in found if h is not None), key=lambda h: -h.log_evidence)


def told(fit: Likelihood, rows: Rows, candidate: Candidate) -> Hypothesis | None:
    """Return the evidence of one candidate whose shape, or window, is known."""
    return _averaged(fit, rows, [candidate])


def refined(fit: Likelihood, rows: Rows, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis whose shape, or window, lies between those of the grid, averaged over the finer cell."""
    if h.candidate.site.window is not None:
        return _located(fit, rows, h)
    columns, at = rows.columns, told(fit, rows, h.candidate)
    if at is None:
        return h
    # What the average has of this shape is replaced by that of the cell around it, which axes share as factors.
    cell = at.log_evidence
    rest = _less(h.log_evidence, cell - math.log(h.tried))
    for name, axis in varied(columns, h.candidate).items():
        now = at.candidate
        values = np.linspace(*axis.limits(now.shape[name]), _FINE)
        near = [columns.candidate(now.effect, now.site, {**now.shape, name: float(v)}) for v in values]
        found = _told(fit, rows, near)
        if not found:
            continue
        cell += _mean(np.array([one.log_evidence for one in found])) - at.log_evidence
        at = max(found, key=lambda one: one.log_evidence)
    return replace(at, log_evidence=float(np.logaddexp(rest, cell - math.log(h.tried))), tried=h.tried)


def _less(total: float, part: float) -> float:
    """Return log(exp(total) - exp(part)), the part being no more than the total but for rounding."""
    return total + math.log(-math.expm1(part - total)) if part < total else -math.inf


def _located(fit: Likelihood, rows: Rows, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis whose window begins and ends when it fits best, near the edges of blocks.

    A load that comes or goes is a step, which whitened rows place to some hundredths of a second: the evidence of a
    window is that of its best edges, averaged over those near them.
    """
    assert h.candidate.site.window is not None
    own = rows.recording == rows.recordings.index(h.candidate.site.window.recording)
    inside, dt = rows.t[own], 2 * rows.dt_out
    best, paid, step = h, 0.0, 2.0 * float(np.ptp(inside)) / len(np.unique(rows.block[own]))
    for edge in ("start_s", "end_s"):
        window = best.candidate.site.window
        assert window is not None
        now = getattr(window, edge)
        if math.isinf(now):
            continue
        times = np.arange(max(now - step, inside[0] + step / 2), min(now + step, inside[-1] - step / 2) + dt, dt)
        windows = [replace(window, **{edge: float(t)}) for t in times]
        sites = [replace(best.candidate.site, window=w) for w in windows if w.end_s - w.start_s > step / 4]
        found = _told(fit, rows, [rows.columns.candidate(best.candidate.effect, site, {}) for site in sites])
        if found:
            best = max(found, key=lambda one: one.log_evidence)
            paid += best.log_evidence - _mean(np.array([one.log_evidence for one in found]))
    if best is h:
        return h
    return replace(best, log_evidence=best.log_evidence - paid - math.log(h.tried), tried=h.tried)


def _told(fit: Likelihood, rows: Rows, candidates: Sequence[Candidate]) -> list[Hypothesis]:
    """Return the evidence of candidates one by one, without those that cannot be evaluated."""
    return [one for c in candidates if (one := told(fit, rows, c)) is not None]


def _may_be(e: Effect, site: Site, rows: Rows) -> bool:
    """Say whether an effect at a site is a hypothesis: torques are known there, and the machine has it not."""
    if site.joint is None:
        return e.first_order is None or rows.n_dof == 1
    return e.whole_robot or rows.seen[site.joint]


def _believed(fit: Likelihood, rows: Rows, candidate: Candidate) -> tuple[np.ndarray, tuple[float, ...]]:
    """Return how large coefficients are believed to be, (K,) and multiples, whatever the time in which they act."""
    always = replace(candidate, site=replace(candidate.site, window=None))
    return coefficient_std(always, rows.features(always), fit.machine.torque_rms)


def _counts(fit: Likelihood, place: int | None, F: np.ndarray) -> bool:
    """Say whether features (K, M) of a joint, or (K, n, M) of all, touch any torque that counts."""
    each = ((F[:, j] if place is None else F)[:, i] for j, i in enumerate(fit.index) if place in (None, j))
    return any(bool(own.any()) for own in each)


def _averaged(fit: Likelihood, rows: Rows, candidates: Sequence[Candidate]) -> Hypothesis | None:
    """Return the evidence of an effect at a place, averaged over its shapes and sizes."""
    parts = [(c, F) for c in candidates if np.isfinite(F := rows.features(c)).all() and _counts(fit, c.place, F)]
    if not parts:
        return None
    S, r = fit.beside(parts[0][0].place, np.concatenate([F for _, F in parts]))
    K = len(parts[0][1])
    at = np.arange(len(parts))[:, None] * K + np.arange(K)
    believed = [_believed(fit, rows, c) for c, _ in parts]
    scales = np.array(believed[0][1])
    std = np.stack([s for s, _ in believed])[:, None] * scales[:, None]
    found = added(S[at[:, :, None], at[:, None, :]][:, None], r[at][:, None], std, parts[0][0].effect.prior.positive)
    shape, size = np.unravel_index(int(found.log_evidence.argmax()), found.log_evidence.shape)
    best = shape, size
    return Hypothesis(
        parts[shape][0], _mean(found.log_evidence), found.mean[best], found.std[best], float(scales[size]), len(parts)
    )


def _mean(log_evidence: np.ndarray) -> float:
    """Return the log of the mean evidence of alternatives that are equally likely."""
    return float(np.asarray(logsumexp(log_evidence))) - math.log(log_evidence.size)


def _in_windows(fit: Likelihood, rows: Rows, e: Effect) -> Iterator[Hypothesis | None]:
    """Yield an effect at every place where it may act for a time, averaged over the stretches of each recording."""
    for number in np.unique(rows.recording):
        name = rows.recordings[number]
        for site in e.sites(rows.columns.robot, (Window(name),)):
            candidate = rows.columns.candidate(e, site, {})
            yield _in_stretches(fit, rows, candidate, int(number), _Stretches.of(rows, int(number)))


@dataclass(frozen=True)
class _Stretches:
    """Stretches of one recording: their edges by block, and the time at each edge [s], infinite at both ends."""

    blocks: np.ndarray
    times: np.ndarray
    whole: bool

    @staticmethod
    def of(rows: Rows, number: int) -> _Stretches:
        inside = rows.recording == number
        blocks, first = np.unique(rows.block[inside], return_index=True)
        step = math.ceil(len(blocks) / (_MOST_EDGES - 1))
        times = np.append(rows.t[inside][first][::step], math.inf)
        times[0] = -math.inf
        return _Stretches(blocks[::step], times, bool((rows.recording != number).any()))

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Yield begin and end of each stretch, by edge; at most most of it, or all where there are other recordings."""
        n = len(self.blocks)
        longest = n if self.whole else math.floor(_MOST_OF_TIME * n)
        return ((a, b) for a in range(n) for b in range(a + 1, n + 1) if b - a <= longest)


def _in_stretches(
    fit: Likelihood, rows: Rows, candidate: Candidate, number: int, stretches: _Stretches
) -> Hypothesis | None:
    """Average over stretches of time that touch torques: moments of a stretch are sums over its blocks."""
    F = rows.features(candidate)
    std, multiples = _believed(fit, rows, candidate)
    V, gram, score = _sums(fit, rows, F, rows.recording == number, stretches.blocks)
    begin, end = np.array(list(stretches), dtype=int).reshape(-1, 2).T
    counts = np.trace(gram[end] - gram[begin], axis1=1, axis2=2) > 0
    if not counts.any():
        return None
    U, scales = V[end] - V[begin], np.array(multiples)
    S = gram[end] - gram[begin] - U.transpose(0, 2, 1) @ U
    r = score[end] - score[begin]
    found = added(S[:, None], r[:, None], std * scales[:, None], candidate.effect.prior.positive)
    told_of = np.where(counts[:, None], found.log_evidence, -math.inf)
    k, size = np.unravel_index(int(told_of.argmax()), told_of.shape)
    window = Window(rows.recordings[number], float(stretches.times[begin[k]]), float(stretches.times[end[k]]))
    best = rows.columns.candidate(candidate.effect, replace(candidate.site, window=window), {})
    return Hypothesis(
        best, _mean(found.log_evidence), found.mean[k, size], found.std[k, size], float(scales[size]), len(begin)
    )


def _sums(
    fit: Likelihood, rows: Rows, F: np.ndarray, inside: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return L^-1 X'C (B + 1, P, K), C'C (B + 1, K, K) and C'e (B + 1, K) of the blocks before each edge."""
    B, K, P = len(edges), len(F), len(fit.gaussian.z)
    cross, gram, score = np.zeros((B, P, K)), np.zeros((B, K, K)), np.zeros((B, K))
    for j, index in enumerate(fit.index):
        if not len(index):
            continue
        own = np.flatnonzero(inside[index])
        C = fit.hyper.noise[j].white(F[:, j])[:, own]
        b, e = fit.gaussian.blocks[j], fit.gaussian.left[j]
        places = np.searchsorted(edges, rows.block[index[own]], side="right") - 1
        for k, part in enumerate(np.split(np.arange(len(own)), np.searchsorted(places, np.arange(1, B)))):
            cross[k, b.own] += b.X[:, own[part]] @ C[:, part].T
            gram[k] += C[:, part] @ C[:, part].T
            score[k] += C[:, part] @ e[own[part]]
    V = fit.gaussian.half(cross.transpose(1, 0, 2).reshape(P, -1))
    before = V.reshape(P, B, K).transpose(1, 0, 2), gram, score
    return tuple(np.concatenate((np.zeros_like(x[:1]), np.cumsum(x, 0))) for x in before)  # type: ignore[return-value]
