"""How many epochs it takes to train a robot: plain Adam against the same Adam in whitened coordinates.

    python benchmarks/training.py [--samples 4000] [--epochs 200] [--seeds 3]

Seven-joint arms of random URDFs (tests/robot), inertials off by 20 %, viscous and Coulomb friction from zero, torque
noise of 5 %. The loss is that of the posterior mode, the batch solution is L-BFGS on it (``BayesianDynamics.fit``); an
epoch counts from which the mean squared torque error on all samples is within 1 % of the batch solution's.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
import torch
from robot.random_robots import random_states, random_urdf
from torch import Tensor

from torchrbd.learning import BayesianDynamics
from torchrbd.model import RigidBodyDynamics
from torchrbd.physics import Site, Term, effect
from torchrbd.robot import RobotModel

BATCH = 128
RATES = (1e-3, 3e-3, 1e-2, 3e-2, 1e-1)
"""Learning rates of Adam; each side is judged by its best."""


def problem(seed: int, n_samples: int) -> tuple[RigidBodyDynamics, tuple[Tensor, ...]]:
    """Return where training starts, and states and torques of the true robot (n_samples, n_dof)."""
    robot = RobotModel.from_urdf(random_urdf(seed, 7, branching=0.0, kinds=("revolute",)))
    rng = np.random.default_rng(seed)
    x = tuple(torch.from_numpy(v) for v in random_states(seed, n_samples, robot.n_dof))
    true = RigidBodyDynamics(robot, terms=friction(robot, 1.0))
    tau = true(*x).detach()
    tau = tau + 0.05 * tau.std(0) * torch.from_numpy(rng.normal(size=tau.shape))
    wrong = robot.pi.reshape(-1, 10) * torch.from_numpy(rng.uniform(0.8, 1.2, (robot.n_bodies, 1)))
    return RigidBodyDynamics(robot, wrong.flatten(), friction(robot, 0.0)), (*x, tau)


def friction(robot: RobotModel, size: float) -> list[Term]:
    """Return viscous and Coulomb friction of every joint."""
    w = torch.tensor([size], dtype=torch.float64)
    names = ("viscous_friction", "coulomb_friction")
    return [Term(effect(name), Site(j), w, {}) for j in range(robot.n_dof) for name in names]


def batches(n_samples: int, seed: int) -> Iterator[Tensor]:
    yield from torch.randperm(n_samples, generator=torch.Generator().manual_seed(seed)).split(BATCH)


def epochs_taken(optimiser: torch.optim.Optimizer, loss: Loss, goal: float, most: int) -> int | None:
    """Return the first epoch after which the error is within 1 % of the goal; None if none is."""
    n = len(loss.data[0])
    for epoch in range(1, most + 1):
        for batch in batches(n, epoch):
            optimiser.zero_grad()
            loss(batch).backward()
            optimiser.step()
        if loss.error() < 1.01 * goal:
            return epoch
    return None


class Loss:
    """Weighed squared torque error of a minibatch."""

    def __init__(self, model: torch.nn.Module, data: tuple[Tensor, ...]) -> None:
        self.model, self.data = model, data
        self.weight = 1.0 / data[3].var(0)

    def __call__(self, batch: Tensor) -> Tensor:
        *x, tau = (v[batch] for v in self.data)
        return ((self.model(*x) - tau).square() * self.weight).mean()

    def error(self) -> float:
        """Return it over all samples."""
        with torch.no_grad():
            return float(self(torch.arange(len(self.data[0]))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=4000)
    parser.add_argument("--epochs", type=int, default=200, help="at most")
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print("| arm | error of the batch solution | epochs, plain (rate) | epochs, whitened (rate) |")
    print("| --- | --- | --- | --- |")
    for seed in range(options.seeds):
        start, data = problem(seed, options.samples)
        solved = BayesianDynamics(start)
        solved.fit(*data)
        goal = Loss(solved, data).error()
        cells = []
        for whitened in (False, True):
            best: tuple[int, float] | None = None
            for rate in RATES:
                bayes = BayesianDynamics(start)
                if whitened:
                    bayes.whiten(*data)
                    loss = Loss(bayes, data)
                    optimiser = torch.optim.Adam([bayes.mean], lr=rate)
                else:
                    model = bayes.robot()
                    loss = Loss(model, data)
                    optimiser = torch.optim.Adam(model.parameters(), lr=rate)
                most = options.epochs if best is None else best[0] - 1
                taken = epochs_taken(optimiser, loss, goal, most)
                best = best if taken is None else (taken, rate)
            cells.append("not reached" if best is None else f"{best[0]} ({best[1]:g})")
        print(f"| {seed} | {goal:.3e} | {cells[0]} | {cells[1]} |", flush=True)


if __name__ == "__main__":
    main()
