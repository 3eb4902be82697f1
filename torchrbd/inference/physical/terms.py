"""Physical parameters of fitted terms, with standard deviations by the delta method."""

from __future__ import annotations

import torch
from torch import Tensor

from torchrbd.inference.data.columns import Candidate
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.results import ParameterEstimate
from torchrbd.inference.shapes.slope import Axis, ShapeSlope, axes

# Of the range of a shape on the grid.
_DIFFERENCE = 1e-3


def term_estimates(model: FittedModel) -> list[ParameterEstimate]:
    """Return the physical parameters of the terms, standard deviations by the delta method."""
    robot, found = model.columns.robot, []
    for candidate in model.proper_terms:
        place, joint = candidate.site.name(robot), candidate.site.joint
        urdf = model.columns.urdf_value(candidate)
        for name, (value, std) in term_parameters(model, candidate).items():
            unit = candidate.effect.unit(name, prismatic=joint is not None and bool(robot.prismatic[joint]))
            found.append(
                ParameterEstimate(f"{candidate.effect.id}_{place}.{name}", place, unit, urdf, value, std, 0.0, "term")
            )
    return found


def term_parameters(model: FittedModel, candidate: Candidate) -> dict[str, tuple[float, float]]:
    """Return value and standard deviation of a term's physical parameters.

        var p = (dp/d(w, theta)) cov(w, theta) (dp/d(w, theta))'

    A refined shape theta has the covariance that the curvature of the profile loss gives it; one that was not refined
    is known to its place on the grid only.
    """
    w, _ = model.coefficients(candidate)
    w, covariance = w.clone().requires_grad_(True), _covariance(model, candidate)
    by_shape = _shape_derivatives(model, candidate)
    found = {}
    for name, value in candidate.effect.parameters(w, candidate.shape).items():
        slope = torch.zeros_like(w)
        if value.requires_grad:
            (slope,) = torch.autograd.grad(value, w, retain_graph=True)
        slope = torch.cat((slope, by_shape[name]))
        found[name] = (float(value.detach()), float(slope @ covariance @ slope) ** 0.5)
    return found


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


def _covariance(model: FittedModel, candidate: Candidate) -> Tensor:
    """Return cov(w, theta), (K + S, K + S)."""
    _, own = model.coefficients(candidate)
    slopes = {c.parameter: c for c in model.terms if isinstance(c, ShapeSlope) and c.belongs_to(candidate)}
    grid = axes(model.columns, candidate)
    grid_only = [_grid_variance(axis, candidate.shape[name]) for name, axis in grid.items()]
    covariance = torch.block_diag(own, torch.diag(torch.tensor(grid_only, dtype=torch.float64)))
    index = model.columns.of(candidate) + [model.columns.of(s)[0] for s in slopes.values()]
    at = torch.tensor([int((model.free == k).nonzero()) for k in index])
    K = len(own)
    to = torch.tensor([*range(K), *(K + list(grid).index(name) for name in slopes)])
    covariance[to.unsqueeze(1), to] = model.covariance[at.unsqueeze(1), at]
    return covariance


def _grid_variance(axis: Axis, value: float) -> float:
    """Return the variance of a value that is known to lie nearer to its grid point than to the next."""
    low, high = axis.neighbours(value)
    return (0.5 * (high - low)) ** 2 / 12
