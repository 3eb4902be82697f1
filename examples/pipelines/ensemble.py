"""Many robots at once: an ensemble is stacked and trained under ``torch.vmap``, each on its own part of the recording.

Each robot sees other stretches of two seconds, drawn with replacement (a block bootstrap), so that what the robots
disagree on is what the recording does not tell. ``torch.func.stack_module_state`` turns the modules into one set of
parameters with a batch dimension.

    python examples/pipelines/ensemble.py
"""

from __future__ import annotations

import copy

import torch
from torch import Tensor
from torch_loop import DEMO, EFFECTS, SLOW, dry_friction, errors, recorded

import torchrbd

ROBOTS, STEPS = 6, 200
BLOCK = 50  # samples: two seconds


def bootstrap(n_samples: int, generator: torch.Generator) -> Tensor:
    """Return how often each sample counts, (N,): blocks are drawn with replacement."""
    n_blocks = -(-n_samples // BLOCK)
    counts = torch.bincount(torch.randint(n_blocks, (n_blocks,), generator=generator), minlength=n_blocks)
    return counts.repeat_interleave(BLOCK)[:n_samples].double()


def main() -> tuple[float, float, float]:
    """Train, and return the held-out error as a part of the URDF's, friction at joint3 and its spread [N m]."""
    model = torchrbd.RigidBodyDynamics.from_urdf(DEMO / "arm.urdf", effects=EFFECTS)
    training, held_out = (recorded(model.robot, name) for name in ("fit", "holdout"))
    before = errors(model, held_out).mean().item()
    generator = torch.Generator().manual_seed(0)
    weights = torch.stack([bootstrap(len(training[0]), generator) for _ in range(ROBOTS)])
    robots = [copy.deepcopy(model) for _ in range(ROBOTS)]
    parameters, buffers = torch.func.stack_module_state(robots)  # pyright: ignore[reportArgumentType]

    def error(parameters: dict[str, Tensor], buffers: dict[str, Tensor], data: tuple[Tensor, ...]) -> Tensor:
        return errors(lambda *states: torch.func.functional_call(model, (parameters, buffers), states), data)

    def loss(parameters: dict[str, Tensor], buffers: dict[str, Tensor], weight: Tensor) -> Tensor:
        moving = training[1].abs() > SLOW
        return (error(parameters, buffers, training) * moving * weight.unsqueeze(1)).mean()

    rates = [{"params": [x], "lr": 0.01 if name == "raw_inertia" else 0.2} for name, x in parameters.items()]
    optimiser = torch.optim.Adam(rates)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, STEPS)
    for _ in range(STEPS):
        optimiser.zero_grad()
        torch.vmap(loss)(parameters, buffers, weights).sum().backward()
        optimiser.step()
        schedule.step()
    with torch.no_grad():
        after = torch.vmap(lambda p, b: error(p, b, held_out))(parameters, buffers).mean().item()
    friction = []
    for k, robot in enumerate(robots):
        robot.load_state_dict({name: x[k] for name, x in (parameters | buffers).items()})
        friction.append(dry_friction(robot, "joint3"))
    mean, spread = torch.tensor(friction).mean().item(), torch.tensor(friction).std().item()
    print(f"held-out nmse: {before:.4f} with the URDF, {after:.5f} with {ROBOTS} robots")
    print(f"Coulomb friction at joint3: {mean:.2f} N m, 2.4 in truth; the robots spread by {spread:.2f} N m")
    return after / before, mean, spread


if __name__ == "__main__":
    main()
