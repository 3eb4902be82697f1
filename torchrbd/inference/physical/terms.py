"""Physical parameters of fitted terms, with standard deviations by the delta method."""

from __future__ import annotations

import torch

from torchrbd.inference.data.columns import Candidate, Columns
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.results import ParameterEstimate


def term_estimates(model: FittedModel) -> list[ParameterEstimate]:
    """Return the physical parameters of the terms, standard deviations by the delta method."""
    robot, found = model.columns.robot, []
    for candidate in model.terms:
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

    var p = (dp/dw) cov(w) (dp/dw)';  a shape parameter is known to its place on the grid only.
    """
    w, covariance = model.coefficients(candidate)
    w = w.clone().requires_grad_(True)
    found = {}
    for name, value in candidate.effect.parameters(w, candidate.shape).items():
        if value.requires_grad:
            (slope,) = torch.autograd.grad(value, w, retain_graph=True)
            std = float(slope @ covariance @ slope) ** 0.5
        else:
            std = _grid_std(model.columns, candidate, name)
        found[name] = (float(value.detach()), std)
    return found


def _grid_std(columns: Columns, candidate: Candidate, name: str) -> float:
    """Return the standard deviation of a value that is known to lie nearer to its grid point than to the next."""
    grid = sorted(shape[name] for shape in candidate.effect.shapes(columns.scale(candidate.site)))
    at = grid.index(candidate.shape[name])
    low, high = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
    return 0.5 * (high - low) / 12**0.5
