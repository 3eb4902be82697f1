"""Torques that a network adds to the physics: any, one that resists motion, or one of a Lagrangian."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from torchrbd.errors import InputError, OptionError
from torchrbd.learning.encoding import Encoder

Kind = Literal["free", "dissipative", "lagrangian"]
KINDS = ("free", "dissipative", "lagrangian")

_WIDTH = 64
# A network that says nothing resists with softplus(-4), a fiftieth of the scale.
_REST = 4.0


class Correction(nn.Module):
    """A torque in units of ``scale``, made by a network.

    Args:
        encoder: makes the network's inputs.
        network: (rows, n_inputs) to (rows, n_outputs); two hidden layers of 64 if None, without a torque at first.
    """

    scale: Tensor

    def __init__(self, encoder: Encoder, network: nn.Module | None) -> None:
        super().__init__()
        self.encoder = encoder
        self.network = mlp(self.n_inputs, self.n_outputs) if network is None else network
        self.register_buffer("scale", torch.ones(encoder.n_dof, dtype=torch.float64))
        if network is not None:
            self._check()

    @property
    def n_inputs(self) -> int:
        """What the network must take."""
        return self.encoder.n_inputs

    @property
    def n_outputs(self) -> int:
        """What the network must give."""
        return self.encoder.n_dof

    def calibrate(self, features: Tensor, scale: Tensor) -> None:
        """Take the size (n,) [N m, N] of the torque to be learned from data with features (N, n_features)."""
        self.scale.copy_(scale)

    def forward(self, features: Tensor) -> Tensor:
        """Return the torque (*batch, n) [N m, N] at features (*batch, n_features)."""
        return self.scale.to(features) * self._outputs(self.encoder(features))

    def _outputs(self, z: Tensor) -> Tensor:
        """Return the network's outputs (*batch, n_outputs) in the inputs' dtype, whatever its own is."""
        own = next((p.dtype for p in self.network.parameters() if p.is_floating_point()), z.dtype)
        return self.network(z.reshape(-1, z.shape[-1]).to(own)).to(z.dtype).reshape(*z.shape[:-1], -1)

    def _check(self) -> None:
        """Try the network.

        Raises:
            InputError: it does not take these inputs or gives other outputs.
        """
        name, expected, was = type(self.network).__name__, (2, self.n_outputs), self.network.training
        device = next((p.device for p in self.network.parameters()), torch.device("cpu"))
        try:
            with torch.no_grad():
                got = tuple(self._outputs(torch.zeros(2, self.n_inputs, device=device)).shape)
        except (RuntimeError, TypeError, AttributeError) as error:
            raise InputError(f"{name}: does not take an input of shape (2, {self.n_inputs}): {error}") from None
        finally:
            self.network.train(was)
        if got != expected:
            raise InputError(f"{name}: gives {got} for an input of shape (2, {self.n_inputs}); expected {expected}")


class Resistance(Correction):
    """A torque that opposes motion at every joint, so that tau . qd >= 0 whatever the network says.

        tau_j = scale_j softplus(n_j(z) - 4) tanh(qd_j / width_j)

    It is positive with qd, as all friction here is: the torque that the actuator must supply.

    Attributes:
        width: (n,) speed below which the direction is uncertain, a fiftieth of the data's spread [rad/s, m/s].
    """

    width: Tensor

    def __init__(self, encoder: Encoder, network: nn.Module | None) -> None:
        super().__init__(encoder, network)
        self.register_buffer("width", torch.full_like(self.scale, 1e-3))

    def calibrate(self, features: Tensor, scale: Tensor) -> None:
        super().calibrate(features, scale)
        n = self.encoder.n_dof
        self.width.copy_((0.02 * features[:, n : 2 * n].std(0)).clamp_min(1e-3))

    def forward(self, features: Tensor) -> Tensor:
        n = self.encoder.n_dof
        level = nn.functional.softplus(self._outputs(self.encoder(features)) - _REST)
        return self.scale.to(features) * level * torch.tanh(features[..., n : 2 * n] / self.width.to(features))


class Lagrangian(Correction):
    """A torque that adds to the robot's Lagrangian: a potential V(q), and optionally kinetic energy qd' M(q) qd / 2.

        tau = dV/dq + d/dt (M qd) - d/dq (qd' M qd) / 2,    M = L L'

    The network has positions as inputs and returns [V, L's lower triangle by rows]. M is never negative, so that mass
    matrices stay positive definite. It must not mix the samples of a batch.

    Args:
        encoder, network: as of ``Correction``.
        kinetic: whether there is an M; else a potential alone.
    """

    def __init__(self, encoder: Encoder, network: nn.Module | None, kinetic: bool) -> None:
        self.kinetic = kinetic
        super().__init__(encoder, network)
        if network is None and kinetic:
            # At L = 0 no M has a slope in L.
            nn.init.normal_(list(self.network.parameters())[-2], std=1e-2)

    @property
    def n_inputs(self) -> int:
        return self.encoder.n_positions

    @property
    def n_outputs(self) -> int:
        n = self.encoder.n_dof
        return 1 + (n * (n + 1) // 2 if self.kinetic else 0)

    def calibrate(self, features: Tensor, scale: Tensor) -> None:
        # One for all joints: a potential's torques are its slopes.
        super().calibrate(features, scale.square().mean().sqrt().expand_as(scale))

    def forward(self, features: Tensor) -> Tensor:
        self.encoder.check(features)
        n = self.encoder.n_dof
        q, qd, qdd = features[..., : 3 * n].unflatten(-1, (3, n)).unbind(-2)
        # Slopes of slopes: bfloat16 does not carry them.
        with torch.autocast(features.device.type, enabled=False):
            tau = torch.func.grad(lambda q: self._said(q)[..., 0].sum())(q)
            if self.kinetic:
                tau = tau + self._momentum(q, qdd) + self._momentum_rate(q, qd)
                tau = tau - torch.func.grad(lambda q: 0.5 * (qd * self._momentum(q, qd)).sum())(q)
        return self.scale[0].to(features) * tau

    def _said(self, q: Tensor) -> Tensor:
        return self._outputs(self.encoder.of_positions(q))

    def _momentum(self, q: Tensor, qd: Tensor) -> Tensor:
        """Return M(q) qd, (*batch, n)."""
        entries = self._said(q)[..., 1:]
        n = q.shape[-1]
        # Built row by row, since what is written in place is traced by no transform.
        rows, start = [], 0
        for j in range(n):
            rows.append(nn.functional.pad(entries[..., start : start + j + 1], (0, n - j - 1)))
            start += j + 1
        L = torch.stack(rows, -2)
        return (L @ (L.mT @ qd.unsqueeze(-1))).squeeze(-1)

    def _momentum_rate(self, q: Tensor, qd: Tensor) -> Tensor:
        """Return (d M qd / dq) qd, (*batch, n): the slope in u of qd . d(u . M qd)/dq, in reverse mode throughout."""

        def along(u: Tensor) -> Tensor:
            return (torch.func.grad(lambda q: (u * self._momentum(q, qd)).sum())(q) * qd).sum()

        return torch.func.grad(along)(torch.zeros_like(qd))


def correction(kind: Kind, encoder: Encoder, network: nn.Module | None, kinetic: bool) -> Correction:
    """Return the correction of a kind.

    Raises:
        OptionError: an unknown kind, or a kinetic part of one that has none.
        InputError: a network of other inputs or outputs.
    """
    if kind not in KINDS:
        raise OptionError(f"kind is '{kind}'; expected one of {', '.join(KINDS)}")
    if kind == "lagrangian":
        return Lagrangian(encoder, network, kinetic)
    if kinetic:
        raise OptionError(f"kinetic belongs to the kind 'lagrangian', not to '{kind}'")
    return Resistance(encoder, network) if kind == "dissipative" else Correction(encoder, network)


def mlp(n_inputs: int, n_outputs: int) -> nn.Sequential:
    """Return a network of two hidden layers that says zero at first."""
    last = nn.Linear(_WIDTH, n_outputs)
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.Linear(n_inputs, _WIDTH), nn.SiLU(), nn.Linear(_WIDTH, _WIDTH), nn.SiLU(), last)
