"""Train a network on what the physics leaves; alone, or in several processes under torch.distributed."""

from __future__ import annotations

import copy
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from rich.console import Console
from rich.progress import track
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torch.utils.data import DataLoader

from torchrbd.errors import OptionError
from torchrbd.learning.checkpoint import read_checkpoint, write_checkpoint
from torchrbd.learning.residual_data import ResidualDataset
from torchrbd.learning.residual_dynamics import ResidualDynamics

# Seconds after which a bar is shown.
_PATIENCE_S = 2.0
# Of time, over which a part that is borne out scatters.
_STRETCHES = 8
# Of the network's rate: the physics' parameters are in place, and only to be set right.
_PHYSICS_RATE = 0.1


@dataclass
class Training:
    """How a training went.

    Attributes:
        loss: per epoch, what was minimised.
        validation: per epoch, the mean squared torque error on data to choose by, in units of noise, of what would be
            kept; the first is the physics alone. Empty without such data.
        best_epoch: whose model was kept, 0 for the physics alone; the last one without data to choose by.
    """

    loss: list[float] = field(default_factory=list)
    validation: list[float] = field(default_factory=list)
    best_epoch: int = 0


class _Objective(nn.Module):
    """The loss, as a module's call, which data-parallel training needs.

        mean w (residual - change of physics - network)^2  +  orthogonality * said  +  anchor * |theta - theta_0|^2

    ``said`` is the mean square of the part of the network's torque that the physics could explain, in units of noise.
    """

    def __init__(self, model: ResidualDynamics, dataset: ResidualDataset, orthogonality: float, anchor: float) -> None:
        super().__init__()
        self.model = model
        device = model.left_std.device
        # Not a submodule's: neither trained nor sent to other processes.
        self._before = [copy.deepcopy(dataset.physics).to(device)]
        self._start = [p.detach().clone() for p in self._before[0].parameters()]
        self._metric = dataset.metric.to(device)
        self._orthogonality, self._anchor = orthogonality, anchor

    def forward(self, features: Tensor, residual: Tensor, weight: Tensor) -> Tensor:
        model = self.model
        left = residual - model.network_torque(features) - model.change(features, self._before[0])
        loss = (weight * left.square()).mean()
        if self._orthogonality:
            loss = loss + self._orthogonality * self._metric.said(model.network_torque(self._metric.features))
        if self._anchor and model.mode != "frozen":
            moved = zip(model.physics.parameters(), self._start, strict=True)
            loss = loss + self._anchor * torch.stack([(p - start).square().sum() for p, start in moved]).sum()
        return loss


def fit_residual(
    model: ResidualDynamics,
    dataset: ResidualDataset,
    *,
    validation: ResidualDataset | None = None,
    epochs: int = 100,
    batch_size: int = 256,
    lr: float = 1e-3,
    weight_decay: float = 0.1,
    orthogonality: float = 10.0,
    anchor: float = 1e-2,
    checkpoint: str | Path | None = None,
    progress: bool = True,
    amp: bool = False,
    seed: int = 0,
) -> Training:
    """Train a ``ResidualDynamics`` in place, and leave it in evaluation mode.

    The loss is the squared torque error in units of each joint's noise, and the penalty. Where torch.distributed runs,
    each process takes its part of every batch. All end with one model, up to rounding that of one process alone.

    Args:
        model: on any device; normalisation and region are taken from the data.
        dataset: training data, the same in all processes.
        validation: validation data. The network's torque is scaled, joint by joint, by the part that this data
            certainly confirms. The best of the models after each epoch, so scaled, and of the physics alone is kept.
            Without validation data nothing keeps the network from learning noise: give some, or few epochs.
        epochs: in all, those of a checkpoint among them.
        batch_size: samples a step, of all processes together.
        lr: AdamW's rate for the network; the physics learns at a tenth of it.
        weight_decay: AdamW's for the network.
        orthogonality: weight of the penalty for torque that the physics could explain [-]. The network keeps about one
            part in (1 + orthogonality) of it. If the physics has never been fitted, fit it or choose less.
        anchor: weight of the squared distance of the physics' parameters from their start, unless frozen.
        checkpoint: a file that is written after every epoch; training resumes from it if it exists.
        progress: show a bar, on a terminal, if training takes over two seconds.
        amp: compute the network in bfloat16; the physics never is.
        seed: of the order of the samples, and of the network's own randomness.

    Raises:
        OptionError: a number that is out of range.
        InputError: data that is not of this model, or a checkpoint that is not.
    """
    for name, value, least in (("epochs", epochs, 0), ("batch_size", batch_size, _size()), ("lr", lr, 0.0)):
        if not value >= least:
            raise OptionError(f"{name} is {value}; expected {least} or more")
    model.calibrate(dataset)
    if validation is not None:
        model.checked(validation)
    done, objective = Training(), _Objective(model, dataset, orthogonality, anchor)
    optimiser = _optimiser(model, lr, weight_decay)
    best: dict[str, Tensor] | None = None
    if checkpoint is not None and Path(checkpoint).exists():
        best, content = read_checkpoint(checkpoint, model, optimiser)
        done = Training(**content)
    elif validation is not None:
        done.validation.append(float((validation.weight * validation.residual.square()).mean()))
    parallel = DistributedDataParallel(objective, broadcast_buffers=False) if _size() > 1 else objective
    for epoch in _shown(len(done.loss), epochs, progress and _rank() == 0):
        model.train()
        with _seeded(seed, epoch):
            done.loss.append(_epoch(model, parallel, optimiser, dataset, batch_size, amp, seed, epoch))
        model.eval()
        if validation is not None:
            done.validation.append(_borne_out(model, validation)[1])
            if done.validation[-1] < min(done.validation[:-1]):
                best, done.best_epoch = {k: v.detach().clone() for k, v in model.state_dict().items()}, epoch + 1
        else:
            done.best_epoch = epoch + 1
        if checkpoint is not None and _rank() == 0:
            write_checkpoint(checkpoint, model, optimiser, best, vars(done))
    _settle(model, dataset, validation, best)
    return done


def _settle(
    model: ResidualDynamics,
    dataset: ResidualDataset,
    validation: ResidualDataset | None,
    best: dict[str, Tensor] | None,
) -> None:
    """Keep the best model, and its residual torque."""
    model.eval()
    if best is not None:
        model.load_state_dict(best)
    elif validation is not None:
        model.silence(dataset.physics)
    if best is not None and validation is not None:
        model.correction.scale.mul_(_borne_out(model, validation)[0].to(model.correction.scale))
    judged = dataset if validation is None else validation
    left, there = model.left(judged).double(), judged.weight > 0
    std = (torch.where(there, left, 0.0).square().sum(0) / there.sum(0)).sqrt()
    model.left_std.copy_(torch.nan_to_num(std))


@torch.no_grad()
def _borne_out(model: ResidualDynamics, validation: ResidualDataset) -> tuple[Tensor, float]:
    """Return the part (n,) of the network's torque, 0 to 1, that new data certainly confirms, and the error with it.

    The part is the slope of the missing torque on the network's, less its standard error over windows of time. It is
    zero where a joint's residual is noise, or where the network helps here and harms there. The error is the mean
    square in units of noise.
    """
    said = model.network_torque(validation.features.to(model.left_std.device)).cpu()
    missing, weight = model.left(validation) + said, validation.weight.double()
    products = torch.stack([weight * x * said for x in (missing, said)])
    if model.kind == "lagrangian":
        # One part for all joints: a potential's torques are its slopes.
        products = products.sum(-1, keepdim=True).expand_as(products)
    stretches = [x.sum(1) for x in products.tensor_split(min(_STRETCHES, len(validation)), dim=1)]
    moment, power = torch.stack(stretches, 1)
    slope = moment.sum(0) / power.sum(0)
    error = (moment - slope * power).square().sum(0).sqrt() / power.sum(0)
    part = torch.nan_to_num(slope - error).clamp(0.0, 1.0)
    return part, float((weight * (missing - part * said).square()).mean())


def _optimiser(model: ResidualDynamics, lr: float, weight_decay: float) -> torch.optim.Optimizer:
    groups: list[dict[str, Any]] = [{"params": list(model.correction.parameters()), "lr": lr}]
    if model.mode != "frozen":
        physics = list(model.physics.parameters())
        groups.append({"params": physics, "lr": _PHYSICS_RATE * lr, "weight_decay": 0.0})
    return torch.optim.AdamW(groups, lr=lr, weight_decay=weight_decay)


def _epoch(
    model: ResidualDynamics,
    objective: nn.Module,
    optimiser: torch.optim.Optimizer,
    dataset: ResidualDataset,
    batch_size: int,
    amp: bool,
    seed: int,
    epoch: int,
) -> float:
    """Go through the data once; return the mean loss of all processes."""
    device, total, count = model.left_std.device, torch.zeros(()), 0
    for batch in DataLoader(dataset, sampler=_batches(len(dataset), batch_size, seed, epoch), batch_size=None):
        optimiser.zero_grad()
        with torch.autocast(device.type, torch.bfloat16, enabled=amp):
            loss = objective(*(x.to(device) for x in batch))
        loss.backward()
        if model.mode == "alternating":
            # The other's turn: what has no gradient is left as it is.
            for p in (model.correction if epoch % 2 else model.physics).parameters():
                p.grad = None
        optimiser.step()
        total, count = total + loss.detach().cpu(), count + 1
    if _size() > 1:
        total = total.to(device)
        dist.all_reduce(total)
        total = total / _size()
    return float(total) / max(count, 1)


def _batches(n: int, batch_size: int, seed: int, epoch: int) -> list[list[int]]:
    """Return this process' part of every batch of an epoch; all processes' are of one size."""
    order = torch.randperm(n, generator=torch.Generator().manual_seed(seed * 1_000_003 + epoch))
    parts = [batch[: len(batch) // _size() * _size()][_rank() :: _size()] for batch in order.split(batch_size)]
    return [part.tolist() for part in parts if len(part)]


@contextmanager
def _seeded(seed: int, epoch: int) -> Iterator[None]:
    """Make what is random in an epoch depend on its number alone, so that a training goes on as if never stopped."""
    with torch.random.fork_rng():
        torch.manual_seed(seed * 1_000_003 + epoch)
        yield


def _shown(start: int, stop: int, progress: bool) -> Iterator[int]:
    """Yield epochs; show a bar on a terminal once they take over two seconds."""
    console, begin, epochs = Console(stderr=True), time.monotonic(), iter(range(start, stop))
    for epoch in epochs:
        yield epoch
        if progress and console.is_terminal and time.monotonic() - begin > _PATIENCE_S:
            left = range(epoch + 1, stop)
            yield from track(left, "training", console=console, transient=True)
            return


def _size() -> int:
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def _rank() -> int:
    return dist.get_rank() if _size() > 1 else 0
