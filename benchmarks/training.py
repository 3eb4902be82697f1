"""How many passes over the data it takes to train a robot to within 1 % of the batch solution.

    PYTHONPATH=examples/pipelines python benchmarks/training.py

The bundled arm's recording as ``examples/pipelines/torch_loop.py`` has it, inertia and friction of the URDF to start
from; squared torque error over each joint's variance. A pass is an epoch of Adam in minibatches, or one evaluation of
L-BFGS with its gradient; *whitened*: in the coordinates of ``BayesianDynamics.whiten``, chosen anew every 15 steps.
The batch solution is the least loss of any of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
import torch_loop
from torch import Tensor, nn

from torchrbd.learning import BayesianDynamics, NaturalGradient, parameter_groups
from torchrbd.model import RigidBodyDynamics

MOST, BATCH, STEPS = 100, 128, 15
RATES = (1e-3, 3e-3, 1e-2, 3e-2, 1e-1)
DAMPING = (1.0, 1e-2, 1e-4)

Schedule = Callable[[int], float]


class Loss:
    """Squared torque error, on some samples or all of them."""

    def __init__(self, data: list[Tensor]) -> None:
        self.data, self.weight = data, 1.0 / data[3].var(0)

    def __call__(self, model: nn.Module, samples: Tensor | slice = slice(None)) -> Tensor:
        *x, tau = (v[samples] for v in self.data)
        return ((model(*x) - tau).square() * self.weight).mean()


def in_minibatches(model: nn.Module, loss: Loss, optimiser: torch.optim.Optimizer, schedule: Schedule) -> list[float]:
    """Return the loss after each epoch."""
    rate, found = torch.optim.lr_scheduler.LambdaLR(optimiser, schedule), []
    for epoch in range(MOST):
        order = torch.randperm(len(loss.data[0]), generator=torch.Generator().manual_seed(epoch))
        for batch in order.split(BATCH):
            optimiser.zero_grad()
            loss(model, batch).backward()
            if isinstance(optimiser, NaturalGradient) and not epoch:
                q, qd, qdd, tau = (v[batch] for v in loss.data)
                optimiser.observe(q, qd, qdd, 2.0 * loss.weight / tau.shape[1])
            optimiser.step()
        rate.step()
        found.append(float(loss(model).detach()))
    return found


def by_natural_gradient(model: RigidBodyDynamics, loss: Loss, damping: float) -> list[float]:
    return in_minibatches(model, loss, NaturalGradient(model, damping=damping), lambda epoch: 1.0 / (1.0 + epoch))


def by_adam(model: RigidBodyDynamics, loss: Loss, rate: float, *, groups: bool) -> list[float]:
    """Adam, its rate falling as a cosine over all epochs."""
    trained = parameter_groups(model, *loss.data, lr=rate) if groups else model.parameters()
    adam = torch.optim.Adam(trained, lr=rate)
    return in_minibatches(model, loss, adam, lambda epoch: 0.5 + 0.5 * math.cos(math.pi * epoch / MOST))


def by_lbfgs(model: nn.Module, loss: Loss, whiten: Callable[[], list[nn.Parameter]], most: int = MOST) -> list[float]:
    """Return the least loss so far after each evaluation; ``whiten`` returns what is trained, every ``STEPS`` steps."""
    found: list[float] = []
    while len(found) < most:
        optimiser = torch.optim.LBFGS(whiten(), max_iter=STEPS, line_search_fn="strong_wolfe", tolerance_change=1e-15)

        def evaluated() -> float:
            optimiser.zero_grad()  # noqa: B023
            value = loss(model)
            value.backward()
            found.append(min([float(value.detach()), *found[-1:]]))
            return float(value.detach())

        optimiser.step(evaluated)
    return found


def whitened(start: RigidBodyDynamics, loss: Loss, most: int = MOST) -> list[float]:
    bayes = BayesianDynamics(start)

    def whiten() -> list[nn.Parameter]:
        bayes.whiten(*loss.data)
        return [bayes.mean]

    return by_lbfgs(bayes, loss, whiten, most)


def told(losses: list[float], goal: float) -> str:
    """Return after how many passes a loss is within 1 % of the goal, and how far it is after 5, 20 and all."""
    within = [k for k, value in enumerate(losses, 1) if value < 1.01 * goal]
    after = " | ".join(f"{losses[min(k, len(losses)) - 1] / goal:.3g}" for k in (5, 20, MOST))
    return f"{within[0] if within else 'never'} | {after}"


def main() -> None:
    torch.set_num_threads(1)
    torch_loop.EVERY = 3

    def start() -> RigidBodyDynamics:
        return RigidBodyDynamics.from_urdf(torch_loop.DEMO / "arm.urdf", effects=torch_loop.EFFECTS)

    data = torch_loop.recorded(start().robot, "fit")
    moving = (data[1].abs() > torch_loop.SLOW).all(1)
    loss, plain = Loss([v[moving] for v in data]), start()
    runs = {f"natural gradient, damping {x:g}": by_natural_gradient(start(), loss, x) for x in DAMPING}
    for groups, name in ((True, "Adam, parameter groups"), (False, "Adam, one rate for all")):
        tried = {rate: by_adam(start(), loss, rate, groups=groups) for rate in RATES}
        rate = min(tried, key=lambda r: min(tried[r]))
        runs[f"{name}, the best of five rates ({rate:g})"] = tried[rate]
    runs["L-BFGS, whitened"] = whitened(start(), loss)
    runs["L-BFGS"] = by_lbfgs(plain, loss, lambda: list(plain.parameters()))
    goal = min(min(losses) for losses in runs.values())
    print(f"{int(moving.sum())} samples; loss of the URDF over that of the batch solution:", end=" ")
    print(f"{float(loss(start()).detach()) / goal:.0f}\n")
    print(
        f"| | passes to within 1 % | after 5 passes, times | after 20 | after {MOST} |\n| --- | --- | --- | --- | --- |"
    )
    for name, losses in runs.items():
        print(f"| {name} | {told(losses, goal)} |")


if __name__ == "__main__":
    main()
