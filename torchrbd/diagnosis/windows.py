"""Windows of time, and recordings, in which an effect may act: the whitened rows say which.

Moments of a window are differences of sums over the rows before its edges. Those of several recordings are sums of
theirs. All of them therefore cost one pass. What comes and goes gradually shows in the rows between its edges. What
does so at once shows at the edges as well, and most of all there if noise is coloured. Windows that begin and end with
blocks of time are judged without their edges; those between moments at which the innovations jump, with them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.edges import Edges
from torchrbd.diagnosis.hypotheses import Hypothesis, hypothesis_of, mean_of, prior_std
from torchrbd.effects import Effect, Site, Window
from torchrbd.likelihood.gaussian import added
from torchrbd.likelihood.likelihood import Likelihood

# Edges of the windows of time in which something may act, spread over a recording.
_MOST_EDGES = 33
# Moments at which something may begin or end for good, and those at which the innovations jump that are looked at.
_MOST_TIMES, _JUMPS = 100, 16
# Every how many rows a moment is tried as an edge.
_ROW_STEP = 2
# What is there for more than this part of a recording is there always.
_MOST_OF_TIME = 0.9
# Of so many recordings all subsets are tried.
_MOST_RECORDINGS = 8


PlaceFilter = Callable[[Effect, Site], bool]
"""Says whether to look for an effect at a site. A window is its whole recording; ``()`` means some recordings."""


def anywhere(effect: Effect, site: Site) -> bool:
    """Return True: look for the effect at the site."""
    return True


def in_windows(
    fit: Likelihood, rows: Rows, effects: Sequence[Effect], wanted: PlaceFilter = anywhere
) -> Iterator[Hypothesis | None]:
    """Yield effects wherever they are wanted and may act for a time, averaged over the windows of each recording.

    What comes and stays, or is there and goes, is as likely as what comes and goes, and another hypothesis; its edge is
    known to some rows. Either may happen at once or gradually.
    """
    for name in rows.seen_recordings:
        places = ((e, site) for e in effects for site in e.sites(rows.columns.robot, (Window(name),)))
        seen = ((e, s) for e, s in places if s.window is not None and (s.joint is None or rows.seen[s.joint]))
        sites = [(e, site) for e, site in seen if wanted(e, site)]
        if not sites:
            continue
        edges = Edges(fit, rows, name)
        kinds = Windows.of_blocks(rows, name), Windows.with_one_end(rows, name), *Windows.at_jumps(edges)
        moments = int(edges.inside.sum()) // _ROW_STEP
        for e, site in sites:
            both, one, both_at_once, one_at_once = weigh_windows(edges, rows.columns.candidate(e, site, {}), kinds)
            yield _either(both, both_at_once, moments * (moments - 1) // 2)
            yield _either(one, one_at_once, 2 * moments)


def _either(
    gradually: tuple[Hypothesis, float] | None, at_once: tuple[Hypothesis, float] | None, count: int
) -> Hypothesis | None:
    """Return a hypothesis that comes and goes gradually or at once, both as likely, of so many windows in all."""
    if gradually is None and at_once is None:
        return None
    evidence = [] if gradually is None else [gradually[0].log_evidence]
    if at_once is not None:
        # Windows that are not tried have no evidence.
        evidence.append(at_once[0].log_evidence + math.log(at_once[0].tried / count))
    best, alone = max((one for one in (gradually, at_once) if one is not None), key=lambda one: one[1])
    # Half of what comes or goes has one end.
    mean = float(np.logaddexp.reduce(evidence)) - 2.0 * math.log(2.0)
    return replace(best, log_evidence=mean, tried=count, paid=mean - alone)


def in_recordings(
    fit: Likelihood, rows: Rows, e: Effect, wanted: PlaceFilter = anywhere
) -> Iterator[Hypothesis | None]:
    """Yield an effect that comes and goes, wherever it is wanted, averaged over its shapes and sets of recordings.

    An effect in some recordings and an effect in all others differ by the effect in all, which friction absorbs if it
    is an offset. Both are as likely, and two hypotheses: those that have the first recording and those that lack it.
    """
    names = rows.seen_recordings
    if not e.comes_and_goes or not 1 < len(names) <= _MOST_RECORDINGS:
        return
    part = np.select([rows.recording == rows.recordings.index(name) for name in names], range(len(names)), -1)
    inside = np.array(
        [chosen for chosen in product((False, True), repeat=len(names)) if any(chosen) and not all(chosen)]
    )
    for site in e.sites(rows.columns.robot):
        if (site.joint is None or rows.seen[site.joint]) and wanted(e, replace(site, recordings=())):
            shapes = e.shapes(rows.columns.scale(site))
            every = [rows.columns.candidate(e, site, shape) for shape in shapes]
            yield from _in_some(fit, rows, every, part, [inside[inside[:, 0] == first] for first in (True, False)])


def _in_some(
    fit: Likelihood, rows: Rows, candidates: Sequence[Candidate], part: np.ndarray, kinds: Sequence[np.ndarray]
) -> Iterator[Hypothesis | None]:
    """Average an effect's shapes over the recordings in which it may act, ``kinds`` of (N, R) bool, for each kind."""
    known = []
    for candidate in candidates:
        F = rows.features(candidate)
        std, multiples = prior_std(fit, rows, candidate)
        if np.isfinite(F).all() and (std > 0).all():
            known.append((candidate, F, std, np.array(multiples)))
    every = []
    if known:
        F = np.concatenate([F for _, F, *_ in known])
        every = _one_by_one(moments(fit, candidates[0].place, F, part, kinds[0].shape[1]), len(known))
    names, shared = np.array(rows.seen_recordings), math.log(len(kinds))
    for inside in kinds:
        evidence, best = [], None
        for (candidate, _, std, scales), parts in zip(known, every, strict=True):
            V, gram, score = (np.tensordot(inside.astype(float), x, 1) for x in parts)
            S = gram - V.transpose(0, 2, 1) @ V
            found = added(S[:, None], score[:, None], std * scales[:, None], candidate.effect.prior.positive)
            evidence.append(found.log_evidence)
            k, size = np.unravel_index(int(found.log_evidence.argmax()), found.log_evidence.shape)
            if best is None or found.log_evidence[k, size] > best[0]:
                at = replace(candidate.site, recordings=tuple(names[inside[k]].tolist()))
                one = rows.columns.candidate(candidate.effect, at, candidate.shape)
                evidence_alone = mean_of(found.log_evidence[k])
                best = (
                    found.log_evidence[k, size],
                    one,
                    found.mean[k, size],
                    found.std[k, size],
                    scales[size],
                    evidence_alone,
                )
        if best is None:
            yield None
            continue
        mean, (_, one, coefficients, std, scale, alone) = mean_of(np.array(evidence)) - shared, best
        yield Hypothesis(one, mean, coefficients, std, float(scale), len(inside) * len(evidence), mean - alone)


def _one_by_one(parts: tuple[np.ndarray, np.ndarray, np.ndarray], count: int) -> list[tuple[np.ndarray, ...]]:
    """Return the moments of so many candidates of as many features, each without those of the others."""
    V, gram, score = parts
    own = np.arange(score.shape[1]).reshape(count, -1)
    return [(V[..., k], gram[:, k[:, None], k], score[:, k]) for k in own]


@dataclass(frozen=True)
class Windows:
    """Windows of one recording.

    Attributes:
        times: (B + 1,) edges [s], from -inf to inf.
        pairs: (N, 2) of them.
        at_once: whether things begin and end at their edges at once.
    """

    times: np.ndarray
    pairs: np.ndarray
    at_once: bool = False

    @staticmethod
    def of_blocks(rows: Rows, recording: str) -> Windows:
        """Return all that begin and end with blocks, or all of it; at most most of it where it is the only one."""
        inside = rows.recording == rows.recordings.index(recording)
        _, first = np.unique(rows.block[inside], return_index=True)
        n = len(first[:: (step := math.ceil(len(first) / (_MOST_EDGES - 1)))])
        times = np.append(rows.t[inside][first][::step], math.inf)
        times[0] = -math.inf
        longest = math.floor(_MOST_OF_TIME * n) if inside.all() else n
        pairs = _pairs(np.arange(n + 1), np.arange(n + 1), longest)
        return Windows(times, pairs[(pairs[:, 0] > 0) == (pairs[:, 1] < n)])

    @staticmethod
    def with_one_end(rows: Rows, recording: str) -> Windows:
        """Return all that begin between two rows and last, or lasted until then; each other row will do."""
        inside = rows.recording == rows.recordings.index(recording)
        step = max(_ROW_STEP, math.ceil(inside.sum() / _MOST_TIMES))
        times = np.concatenate(([-math.inf], rows.t[inside][step:-step:step], [math.inf]))
        return Windows(times, _one_ended(len(times)))

    @staticmethod
    def at_jumps(edges: Edges) -> tuple[Windows, Windows]:
        """Return all between moments at which innovations jump, and those that begin or end at one of them."""
        times = np.concatenate(([-math.inf], edges.rows.t[edges.jumps(_JUMPS)], [math.inf]))
        inner = np.arange(1, len(times) - 1)
        pairs = _pairs(inner, inner, len(times)), _one_ended(len(times))
        both, one = (Windows(times, edges.apart(times, each), at_once=True) for each in pairs)
        return both, one

    @staticmethod
    def near(edges: Edges, window: Window) -> Windows:
        """Return those whose edges lie within a block of a window's."""
        rows = edges.rows
        t, blocks = rows.t[edges.inside], len(np.unique(rows.block[edges.inside]))
        reach = 2.0 * float(np.ptp(t)) / blocks
        least, ends, jumps = t[0] + 0.5 * reach, [], rows.t[edges.jumps(_JUMPS)]
        for now in (window.start_s, window.end_s):
            low, high = max(now - reach, least), min(now + reach, t[-1] - 0.5 * reach)
            fixed = math.isinf(now) or not low < high
            near = jumps[(jumps >= low) & (jumps <= high)]
            ends.append(np.array([now]) if fixed else np.union1d(t[(t >= low) & (t <= high)][::_ROW_STEP], near))
        times = np.unique(np.concatenate((*ends, (-math.inf, math.inf))))
        begin, end = (np.searchsorted(times, e) for e in ends)
        pairs = edges.apart(times, _pairs(begin, end, len(times)))
        return Windows(times, pairs[times[pairs[:, 1]] - times[pairs[:, 0]] > 0.25 * reach], at_once=True)


def _one_ended(edges: int) -> np.ndarray:
    """Return pairs (N, 2) of so many edges that one of the inner ones ends, first those that end there."""
    k = np.arange(1, edges - 1)
    return np.concatenate((np.stack((0 * k, k), 1), np.stack((k, 0 * k + edges - 1), 1)))


def _pairs(begin: np.ndarray, end: np.ndarray, longest: int) -> np.ndarray:
    """Return all (begin, end), (N, 2), that are no longer."""
    pairs = np.stack(np.meshgrid(begin, end, indexing="ij"), -1).reshape(-1, 2)
    length = pairs[:, 1] - pairs[:, 0]
    return pairs[(length > 0) & (length <= longest)]


def weigh_windows(
    edges: Edges, candidate: Candidate, kinds: Sequence[Windows]
) -> list[tuple[Hypothesis, float] | None]:
    """Average over windows of time that touch torques, of one recording and several kinds.

    Moments of a window are differences of those before its edges, which all kinds share.

    Returns:
        For each kind its hypothesis, and the evidence of the best window.
    """
    fit, rows = edges.fit, edges.rows
    always = rows.columns.candidate(candidate.effect, replace(candidate.site, window=None), candidate.shape)
    std, multiples = prior_std(fit, rows, always)
    times = [
        np.unique(np.concatenate([np.zeros(0), *(kind.times for kind in kinds if kind.at_once is at_once)]))
        for at_once in (False, True)
    ]
    sums = _sums(edges, candidate.place, rows.features(always), *times)
    found = []
    for kind in kinds:
        at = np.searchsorted(times[kind.at_once], kind.times) + len(times[0]) * kind.at_once
        found.append(_average_over_windows(rows, candidate, kind, [x[at] for x in sums], std, np.array(multiples)))
    return found


def _average_over_windows(
    rows: Rows,
    candidate: Candidate,
    windows: Windows,
    sums: Sequence[np.ndarray],
    std: np.ndarray,
    scales: np.ndarray,
) -> tuple[Hypothesis, float] | None:
    """Average over windows, given the sums before their edges and standard deviations (K,) with multiples (S,)."""
    V, gram, passed, score = sums
    begin, end = windows.pairs.T
    own = (gram[end] + gram[begin]) - (passed + passed.transpose(0, 2, 1))[begin]
    counts = np.trace(own, axis1=1, axis2=2) > 0
    if not counts.any():
        return None
    products = V.transpose(0, 2, 1) @ V
    S = own - products[end] - products[begin] + _shared(V, begin, end)
    r = score[end] - score[begin]
    found = added(S[:, None], r[:, None], std * scales[:, None], candidate.effect.prior.positive)
    evidence_of = np.where(counts[:, None], found.log_evidence, -math.inf)
    k, size = np.unravel_index(int(evidence_of.argmax()), evidence_of.shape)
    window = candidate.site.window
    assert window is not None
    edges = float(windows.times[begin[k]]), float(windows.times[end[k]])
    best = rows.columns.candidate(
        candidate.effect, replace(candidate.site, window=Window(window.recording, *edges)), candidate.shape
    )
    mean, one = mean_of(found.log_evidence), mean_of(found.log_evidence[k])
    coefficients, std = found.mean[k, size], found.std[k, size]
    return Hypothesis(best, mean, coefficients, std, float(scales[size]), len(begin), mean - one), one


def _shared(V: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return what two edges say together, V_b'V_e + V_e'V_b (N, K, K), of V (B + 1, P, K), zero at the first edge.

    -(V_e - V_b)'(V_e - V_b) = V_b'V_e + V_e'V_b - V_b'V_b - V_e'V_e
    """
    edges, P, K = V.shape
    both, every = np.zeros((len(begin), K, K)), np.moveaxis(V, 0, 1).reshape(P, -1)
    inner = np.flatnonzero(begin)
    few, many = sorted((begin[inner], end[inner]), key=lambda edge: len(np.unique(edge)))
    for k in np.unique(few):
        at = few == k
        both[inner[at]] = (V[k].T @ every).reshape(K, edges, K).swapaxes(0, 1)[many[at]]
    return both + both.transpose(0, 2, 1)


def _sums(
    edges: Edges, place: int | None, F: np.ndarray, gradually: np.ndarray, at_once: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return the moments of what ends at edges, at times (B,) [s] gradually and then at others (E,) at once.

    The rows before an edge are those of the features. If something ends at once, the rows around it differ.

    Returns:
        L^-1 X'G (B + E, P, K), G'G, G'C (B + E, K, K) and G'e (B + E, K) of what ends there, G, and what goes on, C.
    """
    fit, inside = edges.fit, np.flatnonzero(edges.inside)
    first, behind, count = inside[0], inside[-1] + 1, len(gradually)
    at = edges.at(np.concatenate((gradually, at_once)))
    sharp = count + np.flatnonzero(np.isfinite(at_once))
    before = at.copy()
    before[sharp] = np.maximum(at[sharp] - edges.reach, first)
    cuts = np.unique(np.concatenate(([first, behind], before)))
    part = np.full(len(edges.inside), -1)
    part[inside] = np.searchsorted(cuts, inside, side="right") - 1
    parts = moments(fit, place, F, part, len(cuts))
    kept = np.searchsorted(cuts, before)
    V, gram, score = (np.concatenate((np.zeros_like(x[:1]), np.cumsum(x, 0)))[kept] for x in parts)
    passed = gram.copy()
    if len(sharp):
        cross = np.zeros((len(sharp), len(fit.gaussian.z), len(F)))
        for joint, own in _by_joint(fit, place, F):
            block, left = fit.blocks[joint], fit.gaussian.left(joint)
            leap, going, row = edges.leap(joint, own, at[sharp])
            gram[sharp] += leap @ leap.transpose(0, 2, 1)
            passed[sharp] += leap @ going.transpose(0, 2, 1)
            score[sharp] += (leap @ left[row][..., None])[..., 0]
            cross[:, block.own] += block.of_rows(row).swapaxes(0, 1) @ leap.transpose(0, 2, 1)
        V[sharp] += _halves(fit, place, cross)
    return V, gram, passed, score


def _by_joint(fit: Likelihood, place: int | None, F: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the joints that features (K, M) at a place, or (K, n, M) at all, touch, and the features (K, M) there."""
    for j in range(len(fit.index)) if place is None else [place]:
        own = F[:, j] if place is None else F
        if len(fit.index[j]) and own.any():
            yield j, own


def _halves(fit: Likelihood, place: int | None, cross: np.ndarray) -> np.ndarray:
    """Return L^-1 X'C (B, P, K) of X'C (B, P, K); of features at one joint, only where it is not zero."""
    count, P, K = cross.shape
    found = fit.gaussian.half(cross.transpose(1, 0, 2).reshape(P, -1))
    if place is not None:
        found = found[fit.gaussian.root.group_and_shared(place)]
    return found.reshape(-1, count, K).transpose(1, 0, 2)


def moments(
    fit: Likelihood, place: int | None, F: np.ndarray, part: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what a fit's rows say of features, part by part.

    Args:
        fit: the fit.
        place: the joint of the features; None if they are of all.
        F: (K, M), or (K, n, M).
        part: (M,) number of the part that a row belongs to, -1 for none; rows of all parts stand together, in order.
        count: number of parts B.

    Returns:
        L^-1 X'C (B, P, K), C'C (B, K, K) and C'e (B, K), see ``_halves``.
    """
    K, P = len(F), len(fit.gaussian.z)
    cross, gram, score = np.zeros((count, P, K)), np.zeros((count, K, K)), np.zeros((count, K))
    for j, own in _by_joint(fit, place, F):
        of_rows = part[fit.index[j]]
        inside = np.flatnonzero(of_rows >= 0)
        if not len(inside):
            continue
        seen, first = np.unique(of_rows[inside], return_index=True)
        edges = np.append(inside[first], inside[-1] + 1)
        b, C = fit.blocks[j], fit.hyper.noise[j].white(own)
        cross[np.ix_(seen, b.own)] += b.in_parts(C, edges)
        gram[seen] += np.stack([C[:, begin:end] @ C[:, begin:end].T for begin, end in pairwise(edges)])
        score[seen] += np.add.reduceat((C * fit.gaussian.left(j))[:, : edges[-1]], edges[:-1], axis=1).T
    return _halves(fit, place, cross), gram, score


def place_window(fit: Likelihood, rows: Rows, h: Hypothesis) -> Hypothesis:
    """Return a hypothesis whose window begins and ends when it fits best, near the edges of blocks.

    A load that comes or goes is a step, which whitened rows place to some hundredths of a second: the evidence of a
    window is averaged over those near it.
    """
    window = h.candidate.site.window
    assert window is not None
    always = replace(h.candidate, site=replace(h.candidate.site, window=Window(window.recording)))
    edges = Edges(fit, rows, window.recording)
    windows = Windows.near(edges, window)
    (near,) = weigh_windows(edges, always, [windows]) if len(windows.pairs) else (None,)
    exact = None if near is None else hypothesis_of(fit, rows, near[0].candidate)
    if near is None or exact is None:
        return h
    paid = near[1] - near[0].log_evidence - math.log(len(windows.pairs) / h.tried)
    return replace(exact, log_evidence=exact.log_evidence - paid, tried=h.tried, paid=-paid)
