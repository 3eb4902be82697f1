"""Physics and a network for what it leaves: ``tau = physics(q, qd, qdd) + network(features)``."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor, nn

from torchrbd.display import brief
from torchrbd.errors import InputError, OptionError
from torchrbd.learning.corrections import Kind, correction
from torchrbd.learning.encoding import Encoder
from torchrbd.learning.region import EDGE, Region
from torchrbd.model import RigidBodyDynamics

if TYPE_CHECKING:
    from torchrbd.learning.residual_data import ResidualDataset

Mode = Literal["frozen", "joint", "alternating"]
MODES = ("frozen", "joint", "alternating")


@dataclass(frozen=True)
class TorqueShares:
    """Who says how much of the torque on a data set, root mean squares by joint [N m, N].

    Attributes:
        joints: names.
        outside: part of the samples that lie outside the training region, 0 to 1.
        physics_inside, physics_outside: (n,) of the physics' torque; NaN where there are no samples.
        network_inside, network_outside: (n,) of the network's; zero outside by construction, unless it does not fade.
        left_inside, left_outside: (n,) of what both leave of the measured torque; NaN where none is measured.
        alone_inside, alone_outside: (n,) of what the physics alone leaves.
        overlap: part of the network's torque, by power in units of noise, that the physics could say itself, 0 to 1.
    """

    joints: tuple[str, ...]
    outside: float
    physics_inside: Tensor
    physics_outside: Tensor
    network_inside: Tensor
    network_outside: Tensor
    left_inside: Tensor
    left_outside: Tensor
    alone_inside: Tensor
    alone_outside: Tensor
    overlap: float


class ResidualDynamics(nn.Module):
    """A rigid body with terms, and a network for the residual.

        tau = physics(q, qd, qdd) + fade(x) network(x)

        identified = torchrbd.identify("robot.urdf", recordings)
        train, validation = (
            torchrbd.residual_dataset(identified, recordings, split=part) for part in ("train", "validation")
        )
        model = torchrbd.ResidualDynamics(identified.model)
        torchrbd.fit_residual(model, train, validation=validation)
        tau = model(q, qd, qdd)

    Fit the physics first. The network is then fitted to the residual. It is penalised for torque that the physics could
    explain itself (``torchrbd.learning.PhysicsMetric``), so that it does not replace the physics. Its inputs are sines
    and cosines of angles, velocities and accelerations in units of their spread in the data, and optionally history.

    **Far from the data** the network is silent: it fades out from one to two units of distance (``distance``), and
    beyond that the model is its physics. With ``mode="frozen"`` it is never worse there than the physics alone. In the
    other modes that physics is the one that was trained with the network.

    **Uncertainty** (``std``) is a rule, not a posterior: the residual near the data. Further away it grows by the size
    of the torque that the network supplies, per unit of distance beyond the first:

        std_j(x)^2 = left_j^2 + missing_j^2 max(0, s(x) - 1)^2

    Before ``calibrate``, which ``fit_residual`` calls, inputs are not normalised and there is no region.

    Args:
        physics: copied, the original is left alone.
        network: (rows, n_inputs) to (rows, n_outputs); two hidden layers of 64, without a torque at first, if None.
            ``n_inputs`` and ``n_outputs`` of ``model.correction`` say what it must take and give.
        mode: "frozen", the network learns alone; "joint", both learn; "alternating", they take turns by epoch.
        kind: "free"; "dissipative", tau_network . qd >= 0 by construction; "lagrangian", the network is a potential
            V(q), its torque dV/dq. All compose with ``torch.func``; torch.export cannot trace the last one's slopes.
        kinetic: of the kind "lagrangian", add kinetic energy too.
        history: steps of history among the features, the present one among them; of the clock of the data.
        fade: whether the network is silent far from the data. Without it nothing is guaranteed outside.

    Attributes:
        left_std: (n,) root mean square of the residual torque of both near the data [N m, N].
        missing_std: (n,) the same of the physics alone.

    Raises:
        InputError: a network that does not fit.
        OptionError: an unknown mode or kind.
    """

    left_std: Tensor
    missing_std: Tensor

    def __init__(
        self,
        physics: RigidBodyDynamics,
        network: nn.Module | None = None,
        *,
        mode: Mode = "frozen",
        kind: Kind = "free",
        kinetic: bool = False,
        history: int = 0,
        fade: bool = True,
    ) -> None:
        super().__init__()
        if not isinstance(physics, RigidBodyDynamics):
            raise InputError(f"physics is a {type(physics).__name__}; expected a torchrbd.RigidBodyDynamics")
        if mode not in MODES:
            raise OptionError(f"mode is '{mode}'; expected one of {', '.join(MODES)}")
        if history < 0:
            raise OptionError(f"history is {history}; expected 0 or more steps")
        self.mode, self.kind, self.fades = mode, kind, fade
        self.physics = copy.deepcopy(physics).requires_grad_(mode != "frozen")
        self.correction = correction(kind, Encoder(physics.robot, history), network, kinetic)
        self.region = Region(self.encoder.n_inputs)
        for name in ("left_std", "missing_std"):
            self.register_buffer(name, torch.zeros(physics.robot.n_dof, dtype=torch.float64))

    def __repr__(self) -> str:
        weights = sum(p.numel() for p in self.correction.parameters())
        return brief(self, physics=self.physics, kind=self.kind, mode=self.mode, network_parameters=weights)

    @property
    def encoder(self) -> Encoder:
        """Makes the network's inputs."""
        return self.correction.encoder

    @property
    def history(self) -> int:
        """Steps of history among the features."""
        return self.encoder.history

    def forward(
        self,
        q: Tensor,
        qd: Tensor,
        qdd: Tensor,
        history: Tensor | None = None,
        t: Tensor | None = None,
        temperature: Tensor | None = None,
        recording: str | None = None,
    ) -> Tensor:
        """Return the torque that the actuators must supply, (*batch, n) [N m, N].

        Args:
            q, qd, qdd: (*batch, n), [rad, m] and per second, per second squared.
            history: (*batch, h, 2, n) position errors q_ref - q and velocities, the present step first.
            t, temperature, recording: for the physics, as in ``RigidBodyDynamics``.

        Raises:
            InputError: states or history of another shape.
        """
        physics = self.physics(q, qd, qdd, t, temperature, recording)
        return physics + self.network_torque(self.features(q, qd, qdd, history))

    def features(self, q: Tensor, qd: Tensor, qdd: Tensor, history: Tensor | None = None) -> Tensor:
        """Return the features (*batch, (3 + 2 h) n) of states; arguments as in ``forward``.

        Raises:
            InputError: no history where there should be, or of another shape.
        """
        self.physics.robot.check(q, qd, qdd)
        parts, h, n = list(torch.broadcast_tensors(q, qd, qdd)), self.history, q.shape[-1]
        got = (0,) if history is None else tuple(history.shape[-3:])
        if got != ((h, 2, n) if h else (0,)):
            expected = f"(..., {h}, 2, {n}), position errors and velocities" if h else "none"
            raise InputError(f"history is {'none' if history is None else tuple(history.shape)}; expected {expected}")
        if history is not None:
            parts.append(history.flatten(-3).expand(*parts[0].shape[:-1], -1))
        return torch.cat(parts, -1)

    def network_torque(self, features: Tensor) -> Tensor:
        """Return what the network adds, (*batch, n) [N m, N]: faded, scaled, in the features' dtype."""
        tau = self.correction(features)
        return tau * self.region.fade(self.encoder(features)).unsqueeze(-1) if self.fades else tau

    def physics_torque(self, features: Tensor) -> Tensor:
        """Return the physics' torque (*batch, n) at features; for physics without memory or time."""
        return _torque(self.physics, features)

    def distance(self, features: Tensor) -> Tensor:
        """Return how far features are from the training data, (*batch).

        The distance is in the space of network inputs, to the nearest of up to 512 points that cover the data. Its unit
        is the median distance of one window of the data from all others: that of a new window of the same motion.
        """
        return self.region(self.encoder(features))

    def inside(self, features: Tensor) -> Tensor:
        """Say which features lie in the training region, (*batch) bool; beyond it the network is silent."""
        return self.distance(features) < EDGE

    def std(self, features: Tensor) -> Tensor:
        """Return the uncertainty of the predicted torque, (*batch, n) [N m, N]; see above."""
        beyond = (self.distance(features) - 1.0).clamp_min(0.0).unsqueeze(-1)
        return (self.left_std.to(features).square() + (self.missing_std.to(features) * beyond).square()).sqrt()

    def calibrate(self, dataset: ResidualDataset) -> None:
        """Take normalisation, size of the torque and region from training data.

        Raises:
            InputError: data of another robot or history, or none.
        """
        features = self.checked(dataset).features.to(self.correction.scale)
        scale = _rms(dataset.residual, dataset.weight > 0)
        with torch.no_grad():
            self.encoder.calibrate(features)
            self.correction.calibrate(features, torch.nan_to_num(scale).clamp_min(1e-9).to(features))
            self.region.calibrate(self.encoder(features))
            self.left_std.copy_(torch.nan_to_num(scale))
            self.missing_std.copy_(self.left_std)

    @torch.no_grad()
    def left(self, dataset: ResidualDataset) -> Tensor:
        """Return the residual of the measured torque on a data set, (N, n) [N m, N]."""
        said = self.network_torque(dataset.features.to(self.left_std.device)).cpu()
        return dataset.residual - said - self._changed(dataset)

    def change(self, features: Tensor, before: RigidBodyDynamics) -> Tensor:
        """Return how the physics' torque (*batch, n) differs from that of the physics that a residual is of."""
        if self.mode == "frozen":
            return torch.zeros_like(features[..., : self.encoder.n_dof])
        with torch.no_grad():
            was = _torque(before, features)
        return self.physics_torque(features) - was

    def silence(self, physics: RigidBodyDynamics) -> None:
        """Make the model its physics alone: the network's torque is nothing, the physics that which is given."""
        self.physics.load_state_dict(physics.state_dict())
        self.correction.scale.zero_()

    def _changed(self, dataset: ResidualDataset) -> Tensor:
        device = self.left_std.device
        return self.change(dataset.features.to(device), copy.deepcopy(dataset.physics).to(device)).cpu()

    @torch.no_grad()
    def shares(self, dataset: ResidualDataset) -> TorqueShares:
        """Return who says how much of the torque on a data set, inside and outside the training region.

        Raises:
            InputError: data of another robot or history, or none.
        """
        features = self.checked(dataset).features.to(self.left_std.device)
        inside, there = self.inside(features).cpu().unsqueeze(1), dataset.weight > 0
        network, left = self.network_torque(features).cpu(), self.left(dataset)
        physics, every = dataset.physics_torque + self._changed(dataset), there | True
        said = self.network_torque(dataset.metric.features.to(features.device)).cpu()
        return TorqueShares(
            joints=tuple(self.physics.robot.joint_names),
            outside=float((~inside).double().mean()),
            physics_inside=_rms(physics, every & inside),
            physics_outside=_rms(physics, every & ~inside),
            network_inside=_rms(network, every & inside),
            network_outside=_rms(network, every & ~inside),
            left_inside=_rms(left, there & inside),
            left_outside=_rms(left, there & ~inside),
            alone_inside=_rms(left + network, there & inside),
            alone_outside=_rms(left + network, there & ~inside),
            overlap=float(dataset.metric.share(said)),
        )

    def checked(self, dataset: ResidualDataset) -> ResidualDataset:
        """Return a data set that is of this robot and history and has samples.

        Raises:
            InputError: it is not.
        """
        own, other = self.physics.robot.joint_names, dataset.physics.robot.joint_names
        if tuple(own) != tuple(other):
            raise InputError(f"the data are of joints {', '.join(other)}; the model has {', '.join(own)}")
        if dataset.history != self.history:
            raise InputError(
                f"the data have {dataset.history} step(s) of history, the model {self.history}; give both the same"
            )
        if not len(dataset):
            raise InputError("the data have no samples")
        if self.mode == "frozen" and not _same(self.physics, dataset.physics):
            raise InputError("the data are what another physics leaves; make both of one model")
        return dataset


def _torque(physics: RigidBodyDynamics, features: Tensor) -> Tensor:
    """Return the physics' torque (*batch, n) at the states that features (*batch, n_features) begin with."""
    n = physics.robot.n_dof
    return physics(*features[..., : 3 * n].unflatten(-1, (3, n)).unbind(-2))


def _same(one: RigidBodyDynamics, other: RigidBodyDynamics) -> bool:
    a, b = one.state_dict(), other.state_dict()
    return a.keys() == b.keys() and all(torch.equal(a[name].cpu(), b[name].cpu()) for name in a)


def _rms(x: Tensor, which: Tensor) -> Tensor:
    """Return the root mean square over time (n,) of the samples of x (N, n) that count, NaN where none do."""
    return (torch.where(which, x, 0.0).double().square().sum(0) / which.sum(0)).sqrt()
