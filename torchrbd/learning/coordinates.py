"""All that can be trained of a model as one vector, and what the torque is linear in.

theta are log-Cholesky coordinates of the bodies, then coefficients of terms; x = (pi, w) are inertial parameters of all
bodies, then the same coefficients:

    tau = A x,   A = [Y, phi]

Features that depend on the load are those at the model's own parameters, as in a fit.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from torchrbd.effects import Signals
from torchrbd.effects.plain_friction import plain_friction
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.model import RigidBodyDynamics
from torchrbd.model.conditions import interval
from torchrbd.parameters import PARAMETERS_PER_BODY, from_log_cholesky


def flatten(model: RigidBodyDynamics) -> Tensor:
    """Return the model's parameters as one vector theta (n,)."""
    return torch.cat([p.flatten() for p in model.parameters()])


def unflatten(model: RigidBodyDynamics, theta: Tensor) -> dict[str, Tensor]:
    """Return theta (*batch, n) as parameters by name, for ``torch.func.functional_call``."""
    named = dict(model.named_parameters())
    parts = theta.split([p.numel() for p in named.values()], -1)
    return {k: v.unflatten(-1, p.shape) if p.ndim > 1 else v for (k, p), v in zip(named.items(), parts, strict=True)}


def linear_entries(model: RigidBodyDynamics) -> Tensor:
    """Return where in x the entries of theta stand, (n,): those of physical bodies, then the coefficients."""
    bodies = PARAMETERS_PER_BODY * model.physical.nonzero() + torch.arange(
        PARAMETERS_PER_BODY, device=model.physical.device
    )
    n_terms = sum(len(term.coefficients) for term in model.terms)
    return torch.cat((bodies.flatten(), model.robot.n_params + torch.arange(n_terms, device=bodies.device)))


def slopes(model: RigidBodyDynamics, parameters: Mapping[str, Tensor], free: Tensor) -> Tensor:
    """Return dx/dtheta (n_free, n_free) of the free entries of theta, and of those of x that are the same ones."""
    bodies = torch.vmap(torch.func.jacrev(from_log_cholesky))(parameters["raw_inertia"])
    one = bodies.new_ones(sum(w.numel() for name, w in parameters.items() if name != "raw_inertia"))
    return torch.block_diag(*bodies, torch.diag(one))[free.unsqueeze(1), free]


def physics_columns(
    model: RigidBodyDynamics,
    q: Tensor,
    qd: Tensor,
    qdd: Tensor,
    t: Tensor | None = None,
    temperature: Tensor | None = None,
    recording: str | None = None,
    *,
    parameters: Mapping[str, Tensor] | None = None,
) -> Tensor:
    """Return A, (*batch, n_dof, n_params + n_terms): what multiplies inertial parameters and coefficients.

    Args:
        model: whose bodies and terms count.
        q, qd, qdd, t, temperature, recording: as of ``RigidBodyDynamics.forward``.
        parameters: at which features that depend on the load are taken; the model's own if None.
    """
    robot = model.robot
    parameters = dict(model.named_parameters()) if parameters is None else parameters
    pi = _pi(model, parameters)
    coefficients = [parameters[f"_terms.{k}.coefficients"] for k in range(len(model.terms))]
    plain = [(m.effect, m.site.joint, w) for m, w in zip(model.terms, coefficients, strict=True) if m.site.always]
    friction, Y = plain_friction(robot.n_dof, plain), robot.regressor(q, qd, qdd)
    q, qd, qdd = (x.movedim(-1, 0) for x in torch.broadcast_tensors(q, qd, qdd))
    warm = None if temperature is None else temperature.movedim(-1, 0)
    condition = model.condition(recording)
    carried = pi if condition.load is None else pi + condition.load.to(pi)
    signals = Signals(robot, q, qd, qdd, model.rest_width, carried, t, recording, warm, friction)
    columns = [Y]
    for term in model.terms:
        for phi in term.effect.features_at(signals, term.site, term.shape).values():
            own = phi if term.effect.whole_robot else _at(phi, term.site.joint, robot.n_dof)
            columns.append(own.movedim(0, -1).unsqueeze(-1))
    A = torch.cat(columns, -1)
    if not condition.moves_torque:
        return A
    return condition.recorded(A.movedim(-3, -1), interval(t, recording)).movedim(-1, -3)


def felt(columns: Tensor, tau: Tensor) -> Tensor:
    """Return max_j rms(phi_jk) / rms(tau_j) of terms' columns (*batch, n_dof, n_terms), (n_terms,).

    Joints without torque do not count.
    """
    size, torque = (x.square().flatten(0, -k).mean(0).sqrt() for x, k in ((columns, 3), (tau, 2)))
    found = size / torque.unsqueeze(-1)
    return found.nan_to_num(0.0, posinf=0.0).amax(0) if columns.shape[-1] else columns.new_zeros(0)


def linear(model: RigidBodyDynamics, theta: Tensor) -> Tensor:
    """Return x (n_params + n_terms,) at theta (n,)."""
    pi = _pi(model, unflatten(model, theta))
    return torch.cat((pi, theta[model.raw_inertia.numel() :]))


def fitted_covariance(fit: FittedModel, index: Tensor) -> Tensor:
    """Return the covariance of entries of a fit's x; zero for those at -1 and what was not fitted."""
    # The last row and column, where -1 points.
    whole = torch.zeros(fit.columns.n + 1, fit.columns.n + 1, dtype=torch.float64)
    whole[fit.free.unsqueeze(1), fit.free] = fit.covariance
    return whole[index.unsqueeze(1), index]


def linear_positions(model: RigidBodyDynamics, fit: FittedModel) -> Tensor:
    """Return where in x of a fit the coefficients of its module's terms stand, (n_terms,); -1 if not fitted."""
    known = {(c.effect.id, c.site): fit.columns.of(c) for c in fit.proper_terms}
    where, taken = list[int](), set[int]()
    for term in model.terms:
        own = known.get((term.effect.id, term.site), [-1] * len(term.coefficients))
        # A column that two terms share belongs to the first.
        where += [-1 if k in taken else k for k in own]
        taken.update(own)
    return torch.tensor(where, dtype=torch.long)


def _pi(model: RigidBodyDynamics, parameters: Mapping[str, Tensor]) -> Tensor:
    return torch.func.functional_call(_Inertia(model), {f"model.{name}": value for name, value in parameters.items()})


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
