"""Natural gradient for a robot's parameters: steps in the metric of the likelihood and of the bodies.

    theta <- theta - lr s J^-1 (H + lambda_k D)^-1 J^-T grad,   J = dx/dtheta

Torque is linear in x = (pi, w), so that H = mean_i sum_j weight_j A_ij' A_ij of all samples so far is the exact
curvature of the loss in x, near and far. For bodies, D holds the Hessian of the entropic divergence; in its metric a
step of length one still leaves a body. For coefficients it holds the diagonal of H. Damping starts at the mean of
tr(D^-1 H) and falls as one over the steps taken; s <= 1 keeps a step within one of D.

Sources: Amari, "Natural Gradient Works Efficiently in Learning", Neural Computation 1998; Levenberg and Marquardt for
    the damping; Lee, Wensing, Park, "Geometric Robot Dynamic Identification", IEEE T-RO 2020, eq. (25), for D.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torchrbd.display import brief
from torchrbd.errors import OptionError
from torchrbd.learning.body_prior import curvature
from torchrbd.learning.coordinates import flatten, linear_entries, physics_columns, slopes, unflatten
from torchrbd.model import RigidBodyDynamics

# Of the largest curvature, what coefficients have at least: those of which no data were seen.
_UNSEEN = 1e-12


class NaturalGradient(torch.optim.Optimizer):
    """An optimiser for the parameters of a ``RigidBodyDynamics``, in minibatches; a network with it has its own.

        optimiser = NaturalGradient(model)
        schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda epoch: 1 / (1 + epoch))
        for q, qd, qdd, tau in batches:
            optimiser.zero_grad()
            (0.5 * weight * (model(q, qd, qdd) - tau).square()).sum(-1).mean().backward()
            optimiser.observe(q, qd, qdd, weight)
            optimiser.step()

    Args:
        model: whose parameters are stepped; bodies without mass and other constants are none.
        lr: 1 is a Gauss-Newton step. Let it fall, as one over the epochs, to average the noise of minibatches.
        damping: of the first step, as a part of the mean curvature.

    Raises:
        OptionError: lr or damping is not positive.
    """

    def __init__(self, model: RigidBodyDynamics, lr: float = 1.0, damping: float = 1e-2) -> None:
        if not lr > 0.0 or not damping > 0.0:
            raise OptionError(f"NaturalGradient: lr and damping must be positive, got {lr!r} and {damping!r}")
        super().__init__(model.parameters(), {"lr": lr, "damping": damping})
        self._model = [model]
        n = len(linear_entries(model))
        start = flatten(model).detach()
        self.state[model.raw_inertia] = {"sum": start.new_zeros(n, n), "samples": 0, "steps": 0}

    def __repr__(self) -> str:
        group = self.param_groups[0]
        return brief(self, model=self._model[0], lr=group["lr"], damping=group["damping"])

    @torch.no_grad()
    def observe(
        self, q: Tensor, qd: Tensor, qdd: Tensor, weight: Tensor | float = 1.0, t: Tensor | None = None
    ) -> None:
        """Count states in the curvature; those of every batch of the first epoch are enough.

        Args:
            q, qd, qdd, t: as of the model.
            weight: (n_dof,) or a number: of a loss 1/2 sum_j weight_j error_j^2, averaged over the samples.
        """
        model, seen = self._model[0], self.state[self._model[0].raw_inertia]
        columns = physics_columns(model, q, qd, qdd, t)[..., linear_entries(model)]
        rows = columns * torch.as_tensor(weight).to(columns).expand(model.robot.n_dof).sqrt().unsqueeze(-1)
        rows = rows.flatten(0, -2).to(seen["sum"])
        seen["sum"] += rows.mT @ rows
        seen["samples"] += len(rows) // model.robot.n_dof

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> Any:
        """Take a step down the gradients that ``backward`` left; a closure is called first, if given.

        Raises:
            OptionError: nothing was observed.
        """
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        model, seen, group = self._model[0], self.state[self._model[0].raw_inertia], self.param_groups[0]
        if not seen["samples"]:
            raise OptionError(
                "NaturalGradient: no states were observed: call observe(q, qd, qdd, weight) before step()"
            )
        seen["steps"] += 1
        theta, own = flatten(model).to(torch.float64), group["params"]
        J = slopes(model, unflatten(model, theta), torch.arange(len(theta), device=theta.device))
        grad = torch.cat([torch.zeros_like(p).flatten() if p.grad is None else p.grad.flatten() for p in own]).to(theta)
        H, n = seen["sum"].to(theta) / seen["samples"], model.raw_inertia.numel()
        bodies, felt = torch.block_diag(*curvature(model.raw_inertia.to(theta))), H.diagonal()[n:]
        mean = torch.linalg.solve(bodies, H[:n, :n]).diagonal().mean()
        felt = felt.clamp_min(_UNSEEN * float(H.diagonal().max()))
        damping = group["damping"] / seen["steps"] * torch.block_diag(mean * bodies, torch.diag(felt))
        change = -torch.linalg.solve(H + damping, torch.linalg.solve(J.mT, grad))
        length = (change[:n] @ bodies @ change[:n]).sqrt()
        change = group["lr"] / length.clamp_min(1.0) * torch.linalg.solve(J, change)
        for p, part in zip(own, change.split([p.numel() for p in own]), strict=True):
            p += part.reshape(p.shape).to(p)
        return loss
