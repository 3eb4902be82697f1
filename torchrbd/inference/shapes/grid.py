"""Where to start with the shapes of terms: the best points of their grids, from block statistics alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.columns import Candidate
from torchrbd.effects import Site
from torchrbd.inference.preparation import Prepared
from torchrbd.likelihood.equations import linear_fit, scaled_equations

_MOST_SWEEPS = 5

Terms = tuple[Candidate, ...]


def columns_of(prepared: Prepared, terms: Sequence[Candidate]) -> Tensor:
    """Return the columns that a fit of the rigid body and terms moves."""
    own = sorted({k for c in terms for k in prepared.columns.of(c)})
    return torch.cat((prepared.prior.inertial, torch.tensor(own, dtype=torch.long)))


def linear_fit_of(prepared: Prepared, terms: Sequence[Candidate]) -> tuple[Tensor, Tensor]:
    """Return x (n,) of a linear fit of the rigid body and terms, and the noise variance (n_dof,) of each joint."""
    return linear_fit(prepared.training, prepared.prior, columns_of(prepared, terms))


def best_on_grid(prepared: Prepared, terms: Sequence[Candidate]) -> Terms:
    """Return terms with those shapes on their grids that fit best, chosen in turn until none changes.

    Args:
        prepared: the data, with columns for the whole grids.
        terms: one candidate for every term.
    """
    grids: dict[tuple[str, Site], list[Candidate]] = {}
    for c in prepared.columns.candidates:
        grids.setdefault((c.effect.id, c.site), []).append(c)
    places = [(c.effect.id, c.site) for c in terms]
    chosen = {place: grids[place][0] for place in places if len(grids[place]) == 1}
    for _ in range(_MOST_SWEEPS):
        before = dict(chosen)
        for place in places:
            if len(grids[place]) > 1:
                others = [c for other, c in chosen.items() if other != place]
                chosen[place] = _best(prepared, others, grids[place])
        if chosen == before:
            break
    return tuple(chosen[place] for place in places)


def _best(prepared: Prepared, others: Sequence[Candidate], grid: Sequence[Candidate]) -> Candidate:
    """Return the candidate that lowers the loss of a linear fit most, given other terms.

    With S and r the precision and score of its own columns given those of the others, the gain is r' S^-1 r / 2.
    """
    base, (_, noise) = columns_of(prepared, others), linear_fit_of(prepared, others)
    equations = scaled_equations(prepared.prior, prepared.training.total(), prepared.columns, 1.0 / noise)
    known = set(base.tolist())
    fresh = [[k for k in prepared.columns.of(c) if k not in known] for c in grid]
    index = sorted({k for own in fresh for k in own})
    row = {k: i for i, k in enumerate(index)}
    fit, cross = equations.posterior(base), equations.H[base][:, index].numpy()
    S = fit.schur(cross, equations.H[index][:, index].numpy() + np.eye(len(index)))
    r = equations.h[index].numpy() - cross.T @ fit.z
    gains = []
    for own in fresh:
        at = [row[k] for k in own]
        gains.append(float(r[at] @ np.linalg.solve(S[np.ix_(at, at)], r[at])))
    return grid[max(range(len(grid)), key=gains.__getitem__)]
