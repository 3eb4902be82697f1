"""All that can be trained of a model as one vector: log-Cholesky coordinates of the bodies, then coefficients of terms.

    tau(theta) ~ tau(theta_0) + A (theta - theta_0),   A = [Y dpi/dtheta, phi]

``rows`` returns A. Features that depend on the load are those at the model's own parameters, as in a fit.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.model import RigidBodyDynamics
from torchrbd.parameters import PARAMETERS_PER_BODY, from_log_cholesky
from torchrbd.physics import Signals
from torchrbd.physics.plain_friction import plain_friction


def flatten(model: RigidBodyDynamics) -> Tensor:
    """Return the model's parameters as one vector theta (n,)."""
    return torch.cat([p.flatten() for p in model.parameters()])


def unflatten(model: RigidBodyDynamics, theta: Tensor) -> dict[str, Tensor]:
    """Return theta (*batch, n) as parameters by name, for ``torch.func.functional_call``."""
    named = dict(model.named_parameters())
    parts = theta.split([p.numel() for p in named.values()], -1)
    return {k: v.unflatten(-1, p.shape) if p.ndim > 1 else v for (k, p), v in zip(named.items(), parts, strict=True)}


def rows(
    model: RigidBodyDynamics,
    parameters: Mapping[str, Tensor],
    q: Tensor,
    qd: Tensor,
    qdd: Tensor,
    t: Tensor | None = None,
) -> Tensor:
    """Return A, the derivatives of the torques by theta.

    Args:
        model: whose terms and bodies count.
        parameters: by name, see ``unflatten``.
        q, qd, qdd: (*batch, n_dof).
        t: times of the last batch dimension, where terms need them.

    Returns:
        (*batch, n_dof, n).
    """
    robot, raw = model.robot, parameters["raw_inertia"]
    bodies = model.physical.nonzero().flatten()
    slopes = torch.func.vmap(torch.func.jacrev(from_log_cholesky))(raw).to(q)
    Y = robot.regressor(q, qd, qdd).unflatten(-1, (-1, PARAMETERS_PER_BODY))[..., bodies, :]
    inertial = torch.einsum("...dbk,bkl->...dbl", Y, slopes).flatten(-2)
    pi = torch.func.functional_call(_Inertia(model), {f"model.{k}": v for k, v in parameters.items()})
    coefficients = [parameters[f"_terms.{k}.coefficients"] for k in range(len(model.terms))]
    plain = [(m.effect.id, m.site.joint, w) for m, w in zip(model.terms, coefficients, strict=True) if m.site.always]
    friction = plain_friction(robot.n_dof, plain)
    q, qd, qdd = (x.movedim(-1, 0) for x in torch.broadcast_tensors(q, qd, qdd))
    signals = Signals(robot, q, qd, qdd, model.rest_width, pi, t, friction=friction)
    columns = [inertial]
    for term in model.terms:
        for phi in term.effect.features_at(signals, term.site, term.shape).values():
            own = phi if term.effect.whole_robot else _at(phi, term.site.joint, robot.n_dof)
            columns.append(own.movedim(0, -1).unsqueeze(-1))
    return torch.cat(columns, -1)


class _Inertia(torch.nn.Module):
    """Inertial parameters of a model, as a function of its parameters."""

    def __init__(self, model: RigidBodyDynamics) -> None:
        super().__init__()
        self.model = model

    def forward(self) -> Tensor:
        return self.model.pi


def _at(phi: Tensor, joint: int | None, n_dof: int) -> Tensor:
    """Return a feature of one joint as that of all, (n_dof, *batch)."""
    return torch.stack([phi if j == joint else torch.zeros_like(phi) for j in range(n_dof)])


def positions(model: RigidBodyDynamics, fit: FittedModel) -> Tensor:
    """Return where in x of a fit the entries of its module's theta stand, (n,); those that were not fitted are at -1.

    Bodies are there as their inertial parameters, ten for ten coordinates.
    """
    bodies = model.physical.nonzero().flatten().tolist()
    where = [list(range(PARAMETERS_PER_BODY * b, PARAMETERS_PER_BODY * (b + 1))) for b in bodies]
    known = {(c.effect.id, c.site): fit.columns.of(c) for c in fit.proper_terms}
    taken: set[int] = set()
    for term in model.terms:
        own = known.get((term.effect.id, term.site), [])
        # A column that two terms share belongs to the first.
        where.append([-1 if k in taken else k for k in own] or [-1] * len(term.coefficients))
        taken.update(own)
    return torch.tensor([k for own in where for k in own])


def in_log_cholesky(model: RigidBodyDynamics, fit: FittedModel, index: Tensor) -> Tensor:
    """Return the covariance (n, n) of a fit in its module's coordinates theta; zero of what was not fitted."""
    # The last row and column, where -1 points, are zero.
    x = torch.zeros(fit.columns.n + 1, fit.columns.n + 1, dtype=torch.float64)
    x[fit.free.unsqueeze(1), fit.free] = fit.covariance
    slopes = torch.vmap(torch.func.jacrev(from_log_cholesky))(model.raw_inertia.detach())
    n_terms = len(index) - model.raw_inertia.numel()
    to_theta = torch.block_diag(*torch.linalg.inv(slopes), torch.eye(n_terms, dtype=torch.float64))
    return to_theta @ x[index.unsqueeze(1), index] @ to_theta.T
