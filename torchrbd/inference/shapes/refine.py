"""Refine the shapes of terms, and the torques that features are built from, by further passes over the data.

From the best point of the grid on, every pass linearises the terms in their shapes (``likelihood/shapes.py``) and takes
the Gauss-Newton steps of all shapes at once, none further than to the next value on the grid. A term that fits its
joint worse than before goes half the way back. Load and friction are those of the last fit. A shape's prior is
its grid around its present value.

Source: Golub, Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
separate", SIAM J. Numerical Analysis 1973, for the profile (variable projection) problem; solved here in the full
space, whose Gauss-Newton step is the same to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import lsq_linear
from torch import Tensor

from torchrbd._runtime.deadline import is_over
from torchrbd.dataset.block_statistics import assemble
from torchrbd.dataset.columns import Candidate, Through
from torchrbd.dataset.reading import Progress
from torchrbd.dataset.shapes import ShapeSlope, agrees, axes, feature_slopes, slopes
from torchrbd.effects import Shape
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.physical.scatter import block_scatter
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.shapes.grid import Terms, best_on_grid, columns_of, linear_fit_of
from torchrbd.inference.shapes.reread import reread, with_input_noise
from torchrbd.likelihood.equations import Equations

_MOST_PASSES = 12
# A shape has settled if its step is below this part of its standard deviation or of the distance of grid points.
_SETTLED_STD, _SETTLED_GRID = 0.05, 5e-4
# Log-likelihood units that a term may lose in a step: less is chance.
_WORSE = 0.1
# Change of load and friction between passes, as part of the torque.
_SETTLED_LOAD = 1e-4


Carried = tuple[Tensor, Tensor, Through]
"""Inertial parameters (n_params,), friction (n_dof, 3), and what bodies act through."""


@dataclass(frozen=True)
class _Pass:
    """The data read with terms at some shapes.

    Attributes:
        prepared: columns and statistics of the terms and the slopes of their features.
        terms: at the shapes of this pass.
        x: (n,) linear fit of the terms.
        loss: (n_dof,) its 1/2 n_j log sigma_j^2.
        around: (term, shape parameter) of each Gauss-Newton step.
        step, covariance: (S,) unbounded steps, and their covariance (S, S).
    """

    prepared: Prepared
    terms: Terms
    x: Tensor
    loss: Tensor
    around: tuple[tuple[int, str], ...]
    step: np.ndarray
    covariance: np.ndarray

    def loss_of(self, k: int) -> float:
        """Return the loss where term k acts."""
        place = self.terms[k].place
        return float(self.loss.sum() if place is None else self.loss[place])

    def moved(self, shapes: Sequence[Shape]) -> list[Candidate]:
        """Return the terms with other shapes."""
        columns = self.prepared.columns
        return [columns.candidate(c.effect, c.site, shape) for c, shape in zip(self.terms, shapes, strict=True)]

    def next_shapes(self) -> tuple[list[Shape], list[bool]]:
        """Return the next shape of every term, and whether it has settled there.

        Of the steps within the limits, those with the least loss of the linear model: cut off one by one, steps of
        shapes that depend on each other would lead uphill.
        """
        weights = [self.x[self.prepared.columns.of(c)] for c in self.terms]
        shapes = [dict(c.effect.agreeing(w, c.shape)) for c, w in zip(self.terms, weights, strict=True)]
        settled = [agrees(c, w) for c, w in zip(self.terms, weights, strict=True)]
        if not self.around:
            return list(shapes), settled
        grids = [axes(self.prepared.columns, self.terms[k])[name] for k, name in self.around]
        values = np.array([shapes[k][name] for k, name in self.around])
        size = np.sqrt(self.covariance.diagonal())
        limits = np.array([axis.limits(value) for axis, value in zip(grids, values, strict=True)]).T - values
        root = np.linalg.cholesky(np.linalg.inv(self.covariance / np.outer(size, size))).T
        bounded = lsq_linear(root, root @ (self.step / size), limits / size)
        steps = zip(self.around, grids, values, bounded.x * size, size, strict=True)
        for (k, name), axis, value, step, std in steps:
            enough = max(_SETTLED_STD * std, _SETTLED_GRID * axis.spacing(value))
            settled[k] = settled[k] and abs(step) < enough
            shapes[k][name] = float(value + step)
        return list(shapes), settled

    @property
    def carried(self) -> Carried:
        """Inertial parameters and friction of this fit, and what bodies act through."""
        return _carried(self.prepared, self.terms, self.x)

    def load_settled(self) -> bool:
        """Say whether load and friction of this fit are those that features were built from."""
        columns, training = self.prepared.columns, self.prepared.training
        if columns.pi is None:
            return True
        (pi, friction, _), change = self.carried, torch.zeros_like(self.x)
        change[: len(pi)] = pi - columns.pi
        if columns.friction is not None:
            friction = friction - columns.friction
        for c in columns.urdf_friction:
            change[columns.of(c)] = friction[c.joint, c.effect.baseline[0].index(1.0)]
        changes = []
        for own, moments in zip(columns.of_joint, training.total(), strict=True):
            changes.append(change[own] @ moments[:-1, :-1] @ change[own])
        count, _, square = training.torque.sum(0).unbind(-1)
        size = torch.stack(changes).clamp_min(0.0).sqrt() + friction[:, 2].abs() * count.sqrt()
        return bool((size <= _SETTLED_LOAD * square.sqrt()).all())


def refined(prepared: Prepared, terms: Sequence[Candidate], progress: Progress) -> tuple[Prepared, Terms]:
    """Return the data with columns of terms at their refined shapes (and the slopes there), and these terms.

    Where no term has a shape or uses the load, all is left as it is.

    Args:
        prepared: the data, with columns for the whole grids.
        terms: one candidate for every term; at which of its shapes does not matter.
        progress: called with the stage and the part of it that is done.
    """
    if not _refinable(terms):
        return prepared, tuple(terms)
    return refined_from(prepared, best_on_grid(prepared, terms), progress)


def refined_from(prepared: Prepared, terms: Sequence[Candidate], progress: Progress) -> tuple[Prepared, Terms]:
    """Return the same, from shapes that are good already; ``prepared`` has columns for these at least.

    What is known of the states is that for these columns, whether or not there is a shape to refine.
    """
    if not _refinable(terms):
        return with_input_noise(prepared, terms), tuple(terms)
    now = _read(prepared, terms, _carried(prepared, terms, linear_fit_of(prepared, terms)[0]), progress)
    best = [(c.shape, now.loss_of(k)) for k, c in enumerate(now.terms)]
    for _ in range(_MOST_PASSES):
        if is_over():
            break
        shapes, settled = now.next_shapes()
        for k, term in enumerate(now.terms):
            if now.loss_of(k) > best[k][1] + _WORSE:
                shapes[k], settled[k] = _between(best[k][0], term.shape), False
            else:
                best[k] = (term.shape, now.loss_of(k))
        if all(settled) and now.load_settled():
            return _finished(now, progress)
        now = _read(now.prepared, now.moved(shapes), now.carried, progress)
    return _finished(_read(now.prepared, now.moved([shape for shape, _ in best]), now.carried, progress), progress)


def _refinable(terms: Sequence[Candidate]) -> bool:
    return any(c.effect.uses_load or c.shape for c in terms)


def _finished(last: _Pass, progress: Progress) -> tuple[Prepared, Terms]:
    """Return the data read once more with columns of the terms and of their slopes at the fitted coefficients."""
    columns = last.prepared.columns
    around = [s for c in last.terms for s in slopes(columns, c, last.x[columns.of(c)])]
    prepared = reread(
        last.prepared, columns.of_candidates((*last.terms, *around), columns.pi, columns.friction), progress
    )
    return with_input_noise(prepared, last.terms), last.terms


def fit_with_shapes(prepared: Prepared, terms: Sequence[Candidate]) -> FittedModel:
    """Fit refined terms; covariances include what is not known of their shapes."""
    fitted = prepared.fit(terms)
    slopes = (c for c in prepared.columns.candidates if isinstance(c, ShapeSlope))
    around = [slope for slope in slopes if any(slope.belongs_to(c) for c in terms)]
    if around:
        known = prepared.fit((*terms, *around), fitted.noise_variance)
        fitted = replace(known, x=fitted.x, converged=fitted.converged)
    if prepared.states is not None:
        # The states have moved with the parameters; what they would be without a block is not known.
        return fitted
    given = fitted.x, fitted.free, fitted.laplace, fitted.noise_variance
    return replace(fitted, scatter=block_scatter(prepared.training, *given))


def _carried(prepared: Prepared, terms: Sequence[Candidate], x: Tensor) -> Carried:
    columns = prepared.columns
    return x[: prepared.robot.n_params], columns.friction_of(terms, x), columns.shown_bodies(terms, x)


def _read(prepared: Prepared, terms: Sequence[Candidate], carried: Carried, progress: Progress) -> _Pass:
    """Read the data with columns of terms and of the slopes of their features, built from what a fit has carried."""
    columns, terms = prepared.columns, tuple(terms)
    by_term = [feature_slopes(columns, c) for c in terms]
    around = tuple((k, name) for k, own in enumerate(by_term) for name in own)
    known = carried if any(c.effect.uses_load for c in terms) else (None, None, ())
    every = [s for own in by_term for parts in own.values() for s in parts]
    prepared = reread(prepared, columns.of_candidates((*terms, *every), *known), progress)
    columns = prepared.columns
    x, noise = linear_fit_of(prepared, terms)
    count = prepared.training.torque[..., 0].sum(0)
    loss = torch.where(count > 0, 0.5 * count * noise.log(), 0.0)
    slope = torch.zeros(columns.n, len(around), dtype=torch.float64)
    width = np.array([axes(columns, terms[k])[name].std for k, name in around])
    for i, (k, name) in enumerate(around):
        index = [columns.of(s)[0] for s in by_term[k][name]]
        slope[index, i] = width[i] * x[columns.of(terms[k])]
    H, h = assemble(columns, prepared.training.total(), 1.0 / noise)
    into = torch.cat((prepared.prior.scale[:, columns_of(prepared, terms)], slope), 1)
    found = Equations(into.T @ H @ into, into.T @ (h - H @ prepared.prior.mean)).posterior()
    at = np.arange(into.shape[1] - len(around), into.shape[1])
    covariance = found.covariance(at) * np.outer(width, width)
    return _Pass(prepared, terms, x, loss, around, found.z[at] * width, covariance)


def _between(a: Shape, b: Shape) -> Shape:
    return {name: 0.5 * (a[name] + b[name]) for name in a}
