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
# Moments at which something may begin or end for good.
_MOST_TIMES = 600
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
    window is averaged over those near it.
    """
    window = h.candidate.site.window
    assert window is not None
    always = replace(h.candidate, site=replace(h.candidate.site, window=Window(window.recording)))
    stretches = _Stretches.near(rows, window)
    near = _in_stretches(fit, rows, always, stretches)
    exact = None if near is None else told(fit, rows, near[0].candidate)
    if near is None or exact is None:
        return h
    # All that are near stand for one that begins and ends with blocks, or for themselves among finer ones.
    part = len(stretches.pairs) / h.tried if _open(window) else 1.0 / h.tried
    paid = near[1] - near[0].log_evidence - math.log(part)
    return replace(exact, log_evidence=exact.log_evidence - paid, tried=h.tried)


def _open(window: Window) -> bool:
    """Say whether a window has one end only."""
    return math.isinf(window.start_s) != math.isinf(window.end_s)


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
    """Yield an effect at every place where it may act for a time, averaged over the stretches of each recording.

    What comes and stays, or is there and goes, is as likely as what comes and goes; when, is told to some rows.
    """
    for name in rows.seen_recordings:
        kinds = _Stretches.of_blocks(rows, name), _Stretches.with_one_end(rows, name)
        for site in e.sites(rows.columns.robot, (Window(name),)):
            candidate = rows.columns.candidate(e, site, {})
            found = [one[0] for kind in kinds if (one := _in_stretches(fit, rows, candidate, kind)) is not None]
            if not found:
                yield None
                continue
            best = max(found, key=lambda h: h.log_evidence)
            mean = float(np.logaddexp.reduce([h.log_evidence for h in found])) - math.log(len(kinds))
            yield replace(best, log_evidence=mean, tried=len(kinds) * best.tried)


@dataclass(frozen=True)
class _Stretches:
    """Stretches of one recording: its rows (M,), times (B + 1,) of edges [s] from -inf to inf, pairs of them (N, 2)."""

    inside: np.ndarray
    times: np.ndarray
    pairs: np.ndarray

    @staticmethod
    def of_blocks(rows: Rows, recording: str) -> _Stretches:
        """Return all that begin and end with blocks; at most most of it, or all where there are other recordings."""
        inside = rows.recording == rows.recordings.index(recording)
        _, first = np.unique(rows.block[inside], return_index=True)
        n = len(first[:: (step := math.ceil(len(first) / (_MOST_EDGES - 1)))])
        times = np.append(rows.t[inside][first][::step], math.inf)
        times[0] = -math.inf
        longest = math.floor(_MOST_OF_TIME * n) if inside.all() else n
        return _Stretches(inside, times, _pairs(np.arange(n + 1), np.arange(n + 1), longest))

    @staticmethod
    def with_one_end(rows: Rows, recording: str) -> _Stretches:
        """Return all that begin between two rows and last, or lasted until then; each other row will do."""
        inside = rows.recording == rows.recordings.index(recording)
        step = max(2, math.ceil(inside.sum() / _MOST_TIMES))
        times = np.concatenate(([-math.inf], rows.t[inside][step:-step:step], [math.inf]))
        k = np.arange(1, len(times) - 1)
        pairs = np.concatenate((np.stack((0 * k, k), 1), np.stack((k, 0 * k + len(times) - 1), 1)))
        return _Stretches(inside, times, pairs)

    @staticmethod
    def near(rows: Rows, window: Window) -> _Stretches:
        """Return those whose edges lie within a block of a window's."""
        inside = rows.recording == rows.recordings.index(window.recording)
        t, reach = rows.t[inside], 2.0 * float(np.ptp(rows.t[inside])) / len(np.unique(rows.block[inside]))
        least, ends = t[0] + 0.5 * reach, []
        for now in (window.start_s, window.end_s):
            low, high = max(now - reach, least), min(now + reach, t[-1] - 0.5 * reach)
            told = math.isinf(now) or not low < high
            ends.append(np.array([now]) if told else np.arange(low, high, 2 * rows.dt_out))
        times = np.unique(np.concatenate((*ends, (-math.inf, math.inf))))
        begin, end = (np.searchsorted(times, e) for e in ends)
        pairs = _pairs(begin, end, len(times))
        return _Stretches(inside, times, pairs[times[pairs[:, 1]] - times[pairs[:, 0]] > 0.25 * reach])


def _pairs(begin: np.ndarray, end: np.ndarray, longest: int) -> np.ndarray:
    """Return all (begin, end), (N, 2), that are no longer."""
    pairs = np.stack(np.meshgrid(begin, end, indexing="ij"), -1).reshape(-1, 2)
    length = pairs[:, 1] - pairs[:, 0]
    return pairs[(length > 0) & (length <= longest)]


def _in_stretches(
    fit: Likelihood, rows: Rows, candidate: Candidate, stretches: _Stretches
) -> tuple[Hypothesis, float] | None:
    """Average over stretches of time that touch torques; return the evidence of the best one too.

    Moments of a stretch are differences of those before its edges.
    """
    F, site = rows.features(candidate), candidate.site
    std, multiples = _believed(fit, rows, candidate)
    V, gram, score = _sums(fit, rows, F, stretches)
    begin, end = stretches.pairs.T
    counts = np.trace(gram[end] - gram[begin], axis1=1, axis2=2) > 0
    if not counts.any():
        return None
    U, scales = V[end] - V[begin], np.array(multiples)
    S = gram[end] - gram[begin] - U.transpose(0, 2, 1) @ U
    r = score[end] - score[begin]
    found = added(S[:, None], r[:, None], std * scales[:, None], candidate.effect.prior.positive)
    told_of = np.where(counts[:, None], found.log_evidence, -math.inf)
    k, size = np.unravel_index(int(told_of.argmax()), told_of.shape)
    assert site.window is not None
    edges = float(stretches.times[begin[k]]), float(stretches.times[end[k]])
    best = rows.columns.candidate(
        candidate.effect, replace(site, window=Window(site.window.recording, *edges)), candidate.shape
    )
    mean, one = _mean(found.log_evidence), _mean(found.log_evidence[k])
    return Hypothesis(best, mean, found.mean[k, size], found.std[k, size], float(scales[size]), len(begin)), one


def _sums(
    fit: Likelihood, rows: Rows, F: np.ndarray, stretches: _Stretches
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return L^-1 X'C (B + 1, P, K), C'C (B + 1, K, K) and C'e (B + 1, K) of the rows before each edge."""
    B, K, P = len(stretches.times) - 1, len(F), len(fit.gaussian.z)
    cross, gram, score = np.zeros((B, P, K)), np.zeros((B, K, K)), np.zeros((B, K))
    for j, index in enumerate(fit.index):
        if not len(index):
            continue
        own = np.flatnonzero(stretches.inside[index])
        C = fit.hyper.noise[j].white(F[:, j])[:, own]
        b, e = fit.gaussian.blocks[j], fit.gaussian.left[j]
        places = np.searchsorted(stretches.times, rows.t[index[own]], side="right") - 1
        for k, part in enumerate(np.split(np.arange(len(own)), np.searchsorted(places, np.arange(1, B)))):
            cross[k, b.own] += b.X[:, own[part]] @ C[:, part].T
            gram[k] += C[:, part] @ C[:, part].T
            score[k] += C[:, part] @ e[own[part]]
    V = fit.gaussian.half(cross.transpose(1, 0, 2).reshape(P, -1))
    before = V.reshape(P, B, K).transpose(1, 0, 2), gram, score
    return tuple(np.concatenate((np.zeros_like(x[:1]), np.cumsum(x, 0))) for x in before)  # type: ignore[return-value]
