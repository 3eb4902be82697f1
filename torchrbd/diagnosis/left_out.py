"""Evidence of left-out blocks: the equation of ``proof``, the price of choices, and both for the rows of a search.

A search looks at many models. So blocks are left out of its likelihood, whose hyperparameters stay: without a fold f
of the blocks, precision H and shift h lose the fold's part. A term k is left out by conditioning on w_k = 0:

    H_f z_f = h_f,   H_f = H - X_f'X_f,   h_f = h - X_f'y_f,   z_f (without k) = z_f - C_k (C_kk)^-1 z_fk,   C = H_f^-1

Eight factorisations therefore serve all terms. This is done twice, for whitened rows and for rows that count as
independent. Whitened rows give fast torque more weight, independent rows slow torque. Errors of other laws may hide a
term in one of them: the larger evidence counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from torchrbd.dataset.columns import Candidate, Columns
from torchrbd.dataset.rows import Rows
from torchrbd.inference.physical.leave_out import FOLDS, contiguous_folds
from torchrbd.likelihood.likelihood import Likelihood

# Differences of two predictions below this part of the largest, squared, are rounding.
_ROUNDING = 1e-9


def log_evidence(gains: np.ndarray, squares: np.ndarray) -> float:
    """Return log B of gains d (B,) of log density, given |f|^2 (B,), see ``proof``.

    f' e is d + |f|^2 / 2 of the model without the term, and d - |f|^2 / 2 of the one with it.
    """
    felt = squares > _ROUNDING * squares.max(initial=0.0)
    if not felt.any():
        return 0.0
    without, given = (float(((gains + s * squares / 2.0)[felt] ** 2 / squares[felt]).sum()) for s in (1.0, -1.0))
    return 0.5 * int(felt.sum()) * math.log(max(without, 1e-300) / max(given, 1e-300))


def count_choices(term: Candidate, columns: Columns, recording_of_block: Sequence[str]) -> int:
    """Return of how many shapes, times windows between blocks, or sets of recordings, a term's own is one."""
    site, shapes = term.site, len(list(term.effect.shapes(columns.scale(term.site))))
    if site.always:
        times = 1
    elif site.window is None:
        times = 2 ** len(set(recording_of_block)) - 2
    else:
        n = list(recording_of_block).count(site.window.recording)
        times = 2 * (n - 1) if math.inf in (-site.window.start_s, site.window.end_s) else n * (n - 1) // 2
    return shapes * max(times, 1)


def left_out_evidence(fit: Likelihood, rows: Rows, terms: Sequence[Candidate]) -> list[float]:
    """Return log B [nats] of each term of a model on left-out blocks, choices paid; the larger of two, see above.

    Args:
        fit: the model; its first additional columns are those of the terms.
        rows: its rows.
        terms: in this order.
    """
    _, first = np.unique(rows.block, return_index=True)
    recordings = [rows.recordings[k] for k in rows.recording[first]]
    prices = (math.log(count_choices(c, rows.columns, recordings)) for c in terms)
    both = (_fold_evidence(one, rows, terms) for one in (fit, fit.least_squares))
    return [max(each) - price for price, *each in zip(prices, *both, strict=True)]


def _fold_evidence(fit: Likelihood, rows: Rows, terms: Sequence[Candidate]) -> list[float]:
    """Return log B of each term in the rows of a fit, before choices are paid."""
    blocks, block = np.unique(rows.block, return_inverse=True)
    gains, squares = np.zeros((2, len(terms), len(blocks)))
    brief = [c.site.window is not None for c in terms]
    for short in set(brief):
        # What acts for a time is only there to be fitted: its neighbouring blocks are never left out together.
        spread = np.ones(len(blocks), dtype=bool) if short else _blocks_in_windows(rows, terms)
        fold = np.where(spread, np.cumsum(spread) % FOLDS, contiguous_folds(len(blocks), FOLDS).numpy())
        chosen = [k for k, one in enumerate(brief) if one is short]
        for f in np.unique(fold):
            _add_fold(fit, block, fold == f, chosen, gains, squares)
    return [log_evidence(d, square) for d, square in zip(gains, squares, strict=True)]


def _blocks_in_windows(rows: Rows, terms: Sequence[Candidate]) -> np.ndarray:
    """Return in which blocks (B,) bool any of some terms acts that is there for a time."""
    inside = np.zeros(len(rows.t), dtype=bool)
    for window in (c.site.window for c in terms if c.site.window is not None):
        # A window is low-passed as all features are.
        inside |= rows.evaluated(lambda signals: signals.inside(window)) > 0.5  # noqa: B023
    return np.isin(np.unique(rows.block), rows.block[inside])


def _add_fold(
    fit: Likelihood, block: np.ndarray, out: np.ndarray, terms: Sequence[int], gains: np.ndarray, squares: np.ndarray
) -> None:
    """Add what blocks, left out together, say of terms.

    Args:
        fit: to all rows.
        block: (M,) number of each row's block.
        out: (B,) bool, which are left out.
        terms: their numbers.
        gains, squares: (K, B) sums of all terms, changed here.
    """
    each = [np.flatnonzero(out[block[index]]) for index in fit.index]
    rest, parts = fit.gaussian.without(each), zip(fit.blocks, each, fit.index, strict=True)
    left = [(b.own, b.of_rows(at), b.y[at], block[index[at]]) for b, at, index in parts]
    for k in terms:
        at = fit.further(k)
        unit = np.zeros((len(rest.z), len(at)))
        unit[at, np.arange(len(at))] = 1.0
        C = rest.solve(unit)
        step = C @ np.linalg.solve(C[at], rest.z[at])
        for own, X, y, of in left:
            f, e = step[own] @ X, y - rest.z[own] @ X
            squares[k] += np.bincount(of, f**2, len(out))
            gains[k] += np.bincount(of, f * (e + 0.5 * f), len(out))
