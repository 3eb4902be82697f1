"""Physical parameters of fitted terms, with standard deviations by the delta method."""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import Tensor

from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.shapes import Axis, ShapeSlope, axes
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.results import ParameterEstimate

# Part of the coefficients that is rounding.
_ROUNDING = 1e-14
# Of the range of a shape on the grid.
_DIFFERENCE = 1e-3
# A coefficient is significant from so many standard deviations on; another may be so many times its prior size.
_SIGNIFICANT, _WIDE = 3.0, 10.0
# Names of Coulomb friction in motion among an effect's parameters.
_IN_MOTION = ("coulomb", "coulomb_plus", "coulomb_minus")


def term_estimates(model: FittedModel) -> list[ParameterEstimate]:
    """Return the physical parameters of the terms, standard deviations by the delta method."""
    robot, found = model.columns.robot, []
    for candidate in model.proper_terms:
        place, joint = candidate.site.name(robot), candidate.site.joint
        urdf, shares = model.columns.urdf_value(candidate), _prior_shares(model, candidate)
        for name, (value, std) in estimated_parameters(model, candidate).items():
            unit = candidate.effect.unit(name, prismatic=joint is not None and bool(robot.prismatic[joint]))
            share = shares[name] if math.isfinite(std) else math.nan
            found.append(
                ParameterEstimate(f"{candidate.effect.id}_{place}.{name}", place, unit, urdf, value, std, share, "term")
            )
    return found


def term_parameters(model: FittedModel, candidate: Candidate) -> dict[str, tuple[float, float]]:
    """Return value and standard deviation of a term's physical parameters.

        var p = (dp/d(w, theta)) cov(w, theta) (dp/d(w, theta))'

    with the covariance of the fit, or the scatter over blocks where that is more. A refined shape theta has the
    covariance that the curvature of the profile loss gives it; one that was not refined is known to its place on the
    grid only. What depends on a coefficient that moves no joint is not a number.
    """
    w, own = model.coefficients(candidate)
    w = torch.where(own.diagonal() == 0, torch.nan, w).requires_grad_(True)
    at, grid_only = _places(model, candidate)
    by_shape = _shape_derivatives(model, candidate)
    found = {}
    for name, value in candidate.effect.parameters(w, candidate.shape).items():
        if value.isnan():
            found[name] = (math.nan, math.nan)
            continue
        slope = torch.zeros_like(w)
        if value.requires_grad:
            (slope,) = torch.autograd.grad(value, w, retain_graph=True)
        slope = torch.cat((slope, by_shape[name]))
        seen = at >= 0
        g = torch.zeros(len(model.free), dtype=torch.float64).index_add(0, at[seen], slope[seen])
        # A sum of coefficients that is zero is so to rounding.
        estimate = float(value.detach())
        estimate = estimate if abs(estimate) > _ROUNDING * float(w.detach().abs().sum()) else 0.0
        found[name] = (estimate, (_variance(model, g) + float(slope.square() @ grid_only)) ** 0.5)
    return found


def estimated_parameters(model: FittedModel, candidate: Candidate) -> dict[str, tuple[float, float]]:
    """Return the same; NaN where the data leaves a coefficient far more open than its prior does.

    The prior of several coefficients has their proportions: their size is that of the significant ones.
    """
    found, believed = term_parameters(model, candidate), candidate.effect.prior.proportions
    if len(believed) != len(found):
        return found
    sizes = [
        abs(v) / own for (v, std), own in zip(found.values(), believed, strict=True) if abs(v) > _SIGNIFICANT * std
    ]
    widest = _WIDE * max([1.0, *sizes])
    return {
        name: (math.nan, math.nan) if std > widest * own else (v, std)
        for (name, (v, std)), own in zip(found.items(), believed, strict=True)
    }


def coulomb_in_motion(model: FittedModel, laws: Iterable[Candidate]) -> tuple[float, float]:
    """Return the Coulomb friction of several laws at one joint together, and its standard deviation.

    Each law may absorb a part of the others; their sum is better known than any of them. Of friction that differs by
    direction it is the mean of both directions.

    Args:
        model: the fit.
        laws: effects that are ``dry``, all at one joint.
    """
    total, g = 0.0, torch.zeros(len(model.free), dtype=torch.float64)
    for c in laws:
        w = model.coefficients(c)[0].requires_grad_(True)
        parts = [v for name, v in c.effect.parameters(w, c.shape).items() if name in _IN_MOTION]
        own = torch.stack(parts).mean()
        g = g.index_add(0, model.position(c), torch.autograd.grad(own, w)[0])
        total += float(own.detach())
    return total, _variance(model, g) ** 0.5


def _prior_shares(model: FittedModel, candidate: Candidate) -> dict[str, float]:
    """Return which part of what is known of a term's parameters the prior alone says: var(p | data) / var(p)."""
    w, _ = model.coefficients(candidate)
    at, w = model.position(candidate), w.requires_grad_(True)
    found = {}
    for name, value in candidate.effect.parameters(w, candidate.shape).items():
        slope = torch.zeros_like(w)
        if value.requires_grad:
            (slope,) = torch.autograd.grad(value, w, retain_graph=True)
        after, before = (float(slope @ C[at.unsqueeze(1), at] @ slope) for C in (model.laplace, model.prior_covariance))
        found[name] = min(after / before, 1.0) if before > 0.0 else 1.0
    return found


def _variance(model: FittedModel, g: Tensor) -> float:
    """Return the variance of g'x, g (F,): the fit's, or that of the scatter over blocks where it is more."""
    variance = float(g @ model.covariance @ g)
    return variance if model.scatter is None else max(variance, model.scatter.variance(g, variance))


def _shape_derivatives(model: FittedModel, candidate: Candidate) -> dict[str, Tensor]:
    """Return dp/dtheta by physical parameter, over the shapes (S,), by central differences."""
    w, _ = model.coefficients(candidate)
    found: dict[str, list[float]] = {name: [] for name in candidate.effect.units}
    for shape, axis in axes(model.columns, candidate).items():
        h = _DIFFERENCE * (axis.reach or 1.0)
        up, down = (
            candidate.effect.parameters(w, {**candidate.shape, shape: candidate.shape[shape] + s}) for s in (h, -h)
        )
        for name, derivatives in found.items():
            derivatives.append(float(up[name] - down[name]) / (2.0 * h))
    return {name: torch.tensor(d, dtype=torch.float64) for name, d in found.items()}


def _places(model: FittedModel, candidate: Candidate) -> tuple[Tensor, Tensor]:
    """Return where (w, theta) stand among the free columns, -1 for shapes without one, and the variance of those."""
    slopes = {c.parameter: c for c in model.terms if isinstance(c, ShapeSlope) and c.belongs_to(candidate)}
    at = model.position(candidate).tolist()
    variances = [0.0] * len(at)
    for name, axis in axes(model.columns, candidate).items():
        refined = slopes.get(name)
        at.append(-1 if refined is None else int(model.position(refined)))
        variances.append(_grid_variance(axis, candidate.shape[name]) if refined is None else 0.0)
    return torch.tensor(at), torch.tensor(variances, dtype=torch.float64)


def _grid_variance(axis: Axis, value: float) -> float:
    """Return the variance of a value that is known to lie nearer to its grid point than to the next."""
    low, high = axis.neighbours(value)
    return (0.5 * (high - low)) ** 2 / 12
