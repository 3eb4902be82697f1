"""How many passes over the data it takes to train a robot to within 1 % of the batch solution.

    PYTHONPATH=examples/pipelines python benchmarks/training.py

The bundled arm's recording as ``examples/pipelines/torch_loop.py`` has it, inertia and friction of the URDF to start
from; squared torque error over each joint's variance. A pass is an epoch of Adam in minibatches, or one evaluation of
L-BFGS with its gradient; *whitened*: in the coordinates of ``BayesianDynamics.whiten``, chosen anew every 15 steps.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch_loop
from torch import Tensor, nn

from torchrbd.learning import BayesianDynamics
from torchrbd.model import RigidBodyDynamics

MOST, BATCH, STEPS = 100, 128, 15
RATES = (1e-3, 3e-3, 1e-2, 3e-2, 1e-1)


class Loss:
    """Squared torque error, on some samples or all of them."""

    def __init__(self, data: list[Tensor]) -> None:
        self.data, self.weight = data, 1.0 / data[3].var(0)

    def __call__(self, model: nn.Module, samples: Tensor | slice = slice(None)) -> Tensor:
        *x, tau = (v[samples] for v in self.data)
        return ((model(*x) - tau).square() * self.weight).mean()


def by_adam(model: nn.Module, loss: Loss, rate: float) -> list[float]:
    """Return the loss after each epoch."""
    optimiser, found = torch.optim.Adam(model.parameters(), lr=rate), []
    for epoch in range(MOST):
        order = torch.randperm(len(loss.data[0]), generator=torch.Generator().manual_seed(epoch))
        for batch in order.split(BATCH):
            optimiser.zero_grad()
            loss(model, batch).backward()
            optimiser.step()
        found.append(float(loss(model).detach()))
    return found


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


def first(losses: list[float], goal: float) -> str:
    """Return after how many passes a loss is within 1 % of the goal, or how far it is from it at last."""
    within = [k for k, value in enumerate(losses, 1) if value < 1.01 * goal]
    return str(within[0]) if within else f"not in {len(losses)}: {losses[-1] / goal:.2f} times"


def main() -> None:
    torch.set_num_threads(1)
    torch_loop.EVERY = 3

    def start() -> RigidBodyDynamics:
        return RigidBodyDynamics.from_urdf(torch_loop.DEMO / "arm.urdf", effects=torch_loop.EFFECTS)

    data = torch_loop.recorded(start().robot, "fit")
    moving = (data[1].abs() > torch_loop.SLOW).all(1)
    loss = Loss([v[moving] for v in data])
    goal = whitened(start(), loss, 4 * MOST)[-1]
    print(f"{int(moving.sum())} samples; loss of the URDF over that of the batch solution:", end=" ")
    print(f"{float(loss(start()).detach()) / goal:.0f}\n")
    print("| | passes until within 1 % |\n| --- | --- |")
    print(f"| L-BFGS, whitened | {first(whitened(start(), loss), goal)} |", flush=True)
    plain = start()
    print(f"| L-BFGS, plain | {first(by_lbfgs(plain, loss, lambda: list(plain.parameters())), goal)} |", flush=True)
    runs = {rate: by_adam(start(), loss, rate) for rate in RATES}
    rate = min(runs, key=lambda r: min(runs[r]))
    print(f"| Adam, plain, the best of five rates ({rate:g}) | {first(runs[rate], goal)} |")


if __name__ == "__main__":
    main()
