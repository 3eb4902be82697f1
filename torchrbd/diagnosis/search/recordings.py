"""Effects that act in some recordings only: before or after service, cold or warm, with or without a cable.

With C_r the columns of a candidate in the rows of recording r alone, one coefficient for a set S of recordings gains

    1/2 u' (sum_{r, s in S} G_rs + 1)^-1 u
    u = sum_{r in S} C_r' e,   G_rs = delta_rs C_r'C_r - V_r'V_s,   V_r = L^-1 X'C_r

beside a fit (see ``rows/regression.py``). Sets grow by the recording that gains most; nothing is fitted anew.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.rows.samples import Samples
from torchrbd.diagnosis.search.grid import Grid, Group, Screened, fresh_columns
from torchrbd.likelihood.columns import Candidate


def recordings(samples: Samples) -> tuple[str, ...]:
    """Return the names of the recordings that samples are of."""
    return tuple(samples.recordings[k] for k in np.unique(samples.recording))


def screened_by_recordings(grid: Grid, fit: Fit) -> list[Screened]:
    """Return each effect that may come and go, at each place, in those recordings in which it gains most.

    Best score first; the score counts the choice among the sets of recordings. None where there is one recording only.
    """
    best: dict[tuple[str, object], Screened] = {}
    if len(recordings(fit.rows.samples)) > 1:
        for group in grid.groups:
            for one in _screened(group, fit):
                key = one.candidate.effect.id, replace(one.candidate.site, recordings=None)
                if key not in best or one.score > best[key].score:
                    best[key] = one
    return sorted(best.values(), key=lambda one: -one.score)


def _screened(group: Group, fit: Fit) -> Iterator[Screened]:
    if not len(group.features):
        return
    rows, samples = fit.rows, fit.rows.samples
    names = recordings(samples)
    part = slice(None) if group.place is None else rows.parts[group.place]
    number = np.unique(samples.recording[np.concatenate(rows.index)], return_inverse=True)[1][part]
    C, X, e = group.widened(rows)[part], fit.X[part], fit.e[part]
    here = [number == r for r in range(len(names))]
    V = np.stack([fit.posterior.half(X[at].T @ C[at]) for at in here])
    own, u = np.stack([C[at].T @ C[at] for at in here]), np.stack([C[at].T @ e[at] for at in here])
    freedom, choice = 0.5 * np.log(max(rows.counts.max(), 2)), (len(names) - 1) * np.log(2.0)
    for c in (c for c in group.candidates if c.effect.comes_and_goes):
        at = [group.columns[label] for label in c.labels if label in group.columns]
        if not at:
            continue
        cost = freedom * c.effect.complexity + choice
        G = -np.einsum("rpk,spl->rskl", V[:, :, at], V[:, :, at])
        G[range(len(names)), range(len(names))] += own[:, at][:, :, at]
        if _gains(G.transpose(0, 2, 1, 3).reshape(1, u[:, at].size, -1), u[:, at].reshape(1, -1))[0] > cost:
            gain, chosen = _best_set(G, u[:, at])
            inside = replace(c.site, recordings=tuple(names[r] for r in chosen))
            yield Screened(fit.rows.samples.columns.candidate(c.effect, inside, c.shape), gain, gain - cost)


def _gains(G: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the gains (...) of columns with products G (..., K, K) and scores u (..., K)."""
    w = np.linalg.solve(G + np.eye(G.shape[-1]), u[..., None])[..., 0]
    return 0.5 * (w * u).sum(-1)


def _best_set(G: np.ndarray, u: np.ndarray) -> tuple[float, tuple[int, ...]]:
    """Return the gain of the best set of recordings that is not all of them, and the set.

    Args:
        G: (R, R, K, K) products of the columns of one recording and another.
        u: (R, K) scores.
    """
    chosen: list[int] = []
    found: list[tuple[float, tuple[int, ...]]] = []
    for _ in range(len(u) - 1):
        rest = [r for r in range(len(u)) if r not in chosen]
        sets = [[*chosen, r] for r in rest]
        gains = _gains(np.stack([G[s][:, s].sum((0, 1)) for s in sets]), np.stack([u[s].sum(0) for s in sets]))
        chosen = sets[int(gains.argmax())]
        found.append((float(gains.max()), tuple(sorted(chosen))))
    return max(found)


def where_larger(fit: Fit, candidate: Candidate) -> Candidate:
    """Return a candidate for some recordings, or for all others, whichever have more of its torque.

    Where the same effect stands in the model for all recordings, a term in some says the same as one in the others.
    """
    rows, samples, site = fit.rows, fit.rows.samples, candidate.site
    assert site.recordings is not None
    common = samples.columns.candidate(candidate.effect, replace(site, recordings=None), candidate.shape)
    places = [(common.place, label) for label in common.labels]
    C = fresh_columns(fit, candidate)
    if not set(places) <= set(fit.places) or C.shape[1] != len(places):
        return candidate
    _, more = fit.addition(C)
    x = fit.coefficients_with(C, more)[len(fit.x) - len(fit.places) :]
    features = samples.features(common)
    elsewhere = x[[fit.places.index(p) for p in places]] * rows.widths_of(common)
    elsewhere[0] += samples.columns.urdf_value(common)
    inside = elsewhere + more * rows.widths_of(candidate)
    if np.square(np.tensordot(inside, features, 1)).sum() >= np.square(np.tensordot(elsewhere, features, 1)).sum():
        return candidate
    others = tuple(name for name in recordings(samples) if name not in site.recordings)
    return samples.columns.candidate(candidate.effect, replace(site, recordings=others), candidate.shape)


def explained(fit: Fit, candidate: Candidate) -> float:
    """Return the part of the power that is left in a candidate's recordings, at its joints, that it takes away."""
    samples, site = fit.rows.samples, candidate.site
    assert site.recordings is not None
    here = np.isin(samples.recording, [samples.recordings.index(name) for name in site.recordings])
    joints = slice(None) if candidate.place is None else [candidate.place]
    beside = Fit(fit.rows, (*fit.terms, candidate))
    before, after = (np.square((f.leftover() * samples.weight)[joints][:, here]).sum() for f in (fit, beside))
    return float(1.0 - after / max(before, 1e-300))
