"""Many robots of one kind, each with its own parameters, as one module: for domain randomisation."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from torchrbd.display import brief
from torchrbd.model import RigidBodyDynamics


class ManyRobots(nn.Module):
    """Robots that are computed side by side: state k is robot k's.

        robots = bayes.sample_robots(64)
        q, qd = robots.step(q, qd, tau, 1e-3)     # q, qd, tau: (64, *batch, n_dof)

    Args:
        model: whose tree, terms and shapes all have.
        parameters: by name as the model's own, with the robots first.
    """

    def __init__(self, model: RigidBodyDynamics, parameters: Mapping[str, Tensor]) -> None:
        super().__init__()
        self._call = _Call(copy.deepcopy(model).requires_grad_(False))
        # Names of parameters have no dots.
        self._names = tuple(parameters)
        self._stacked = nn.ParameterList([nn.Parameter(v) for v in parameters.values()])

    def __repr__(self) -> str:
        return brief(self, robots=len(self), model=self._call.model)

    def __len__(self) -> int:
        return len(self._stacked[0])

    def __getitem__(self, k: int) -> RigidBodyDynamics:
        """Return a copy of robot k."""
        model = copy.deepcopy(self._call.model)
        own = {name: v[k].detach() for name, v in zip(self._names, self._stacked, strict=True)}
        model.load_state_dict(own, strict=False)
        return model.requires_grad_(True)

    def forward(self, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return the torques, as ``RigidBodyDynamics.forward``: all (n_robots, *batch, n_dof)."""
        return self._each("forward", q, qd, qdd)

    def forward_dynamics(self, q: Tensor, qd: Tensor, tau: Tensor) -> Tensor:
        """Return the accelerations (n_robots, *batch, n_dof)."""
        return self._each("forward_dynamics", q, qd, tau)

    def mass_matrix(self, q: Tensor) -> Tensor:
        """Return the mass matrices (n_robots, *batch, n_dof, n_dof)."""
        return self._each("mass_matrix", q)

    def step(self, q: Tensor, qd: Tensor, tau: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Return positions and velocities a time dt [s] later, as ``RigidBodyDynamics.step``."""
        return self._each("step", q, qd, tau, dt=dt)

    def _each(self, method: str, *states: Tensor, **options: Any) -> Any:
        stacked = {f"model.{name}": v for name, v in zip(self._names, self._stacked, strict=True)}

        def one(parameters: dict[str, Tensor], *states: Tensor) -> Any:
            return torch.func.functional_call(self._call, parameters, (method, *states), options)

        return torch.vmap(one)(stacked, *states)


class _Call(nn.Module):
    """Any method of a model as ``forward``, the only one that takes parameters from outside."""

    def __init__(self, model: RigidBodyDynamics) -> None:
        super().__init__()
        self.model = model

    def forward(self, method: str, *states: Tensor, **options: Any) -> Any:
        return getattr(self.model, method)(*states, **options)
