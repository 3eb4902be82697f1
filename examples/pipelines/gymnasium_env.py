"""A gymnasium environment of an arm with friction, whose inertia, friction and rotors are drawn anew at every reset.

The model is the simulator: ``model.step`` moves it, and whatever is added to its log-Cholesky coordinates, the arm
stays one that can be built. A policy that is to work on the real arm is trained on many such arms; here a controller
that knows the nominal model stands for it. Needs gymnasium: ``pip install torchrbd[examples]``.

    python examples/pipelines/gymnasium_env.py
"""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

import torchrbd

DEMO = Path(torchrbd.__file__).with_name("demo")
EFFECTS = {  # by joint
    "coulomb_friction": [3.0, 4.0, 2.4, 0.3, 0.3, 0.1],  # N m
    "viscous_friction": [3.0, 4.0, 2.4, 0.3, 0.3, 0.1],  # N m s/rad
    "rotor_inertia": [1.0, 1.0, 0.5, 0.1, 0.1, 0.1],  # kg m^2, behind the gear
}


def nominal() -> torchrbd.RigidBodyDynamics:
    """Return the arm with the friction and the rotors that are expected of it."""
    model = torchrbd.RigidBodyDynamics.from_urdf(DEMO / "arm.urdf", effects=list(EFFECTS))
    with torch.no_grad():
        for term, value in zip(model.terms, chain(*EFFECTS.values()), strict=True):
            term.coefficients.fill_(value)
    return model


class Reach(gymnasium.Env[np.ndarray, np.ndarray]):
    """Move all joints to a pose.

    Observation (18,): q [rad], qd [rad/s] and the pose that is wanted [rad]. Action (6,) in [-1, 1]: torque in parts of
    what the joint's motor can. Reward: minus the distance from the pose [rad], each step.

    Args:
        inertia_std: of what is added to the log-Cholesky coordinates; 0.02 is 4 % of a mass and 2 cm of its centre.
        drive_std: of the logarithm of the factor by which friction and rotors differ.
    """

    DT, SUBSTEPS, STEPS = 0.005, 2, 100

    def __init__(self, inertia_std: float = 0.02, drive_std: float = 0.3) -> None:
        self.model, self._nominal = nominal(), nominal()
        self._stds = inertia_std, drive_std
        self._effort = self.model.robot.effort
        n = self.model.robot.n_dof
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (n,), np.float32)
        self._bounds = np.repeat(np.array([np.pi, 100.0, np.pi], np.float32), n)
        self.observation_space = gymnasium.spaces.Box(-self._bounds, self._bounds)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Draw an arm, and a pose to reach from another."""
        super().reset(seed=seed)
        inertia_std, drive_std = self._stds
        with torch.no_grad():
            for (name, x), at in zip(self.model.named_parameters(), self._nominal.parameters(), strict=True):
                drawn = torch.from_numpy(self.np_random.normal(size=tuple(x.shape)))
                x.copy_(at + inertia_std * drawn if name == "raw_inertia" else at * (drive_std * drawn).exp())
        self._q, self._goal = torch.from_numpy(self.np_random.uniform(-0.8, 0.8, (2, self.model.robot.n_dof)))
        self._qd, self._count = torch.zeros_like(self._q), 0
        return self._observation(), {}

    @torch.no_grad()
    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold a torque for a hundredth of a second."""
        tau = torch.from_numpy(np.clip(action, -1.0, 1.0)).to(self._q) * self._effort
        for _ in range(self.SUBSTEPS):
            self._q, self._qd = self.model.step(self._q, self._qd, tau, self.DT)
        self._count += 1
        distance = (self._q - self._goal).norm().item()
        return self._observation(), -distance, False, self._count >= self.STEPS, {"distance": distance}

    def _observation(self) -> np.ndarray:
        x = torch.cat((self._q, self._qd, self._goal)).numpy().astype(np.float32)
        return np.clip(x, -self._bounds, self._bounds)


class Controller:
    """Computed torque towards the pose, by the nominal model; the sign of dry friction is soft, lest it chatters."""

    KP, KD = 100.0, 20.0  # 1/s^2, 1/s

    def __init__(self) -> None:
        self.model = nominal()
        self.model.rest_width.fill_(0.3)

    @torch.no_grad()
    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Return the action."""
        q, qd, goal = torch.from_numpy(observation).double().reshape(3, -1)
        tau = self.model(q, self.KP * (goal - q) / self.KD, self.KP * (goal - q) - self.KD * qd)
        return (tau / self.model.robot.effort).clamp(-1.0, 1.0).float().numpy()


def main(episodes: int = 2) -> float:
    """Return the largest of the distances that are left after a second, as parts of those at the start."""
    environment, controller, left = Reach(), Controller(), []
    for seed in range(episodes):
        observation, _ = environment.reset(seed=seed)
        start, done = float(np.linalg.norm(observation[:6] - observation[12:])), False
        while not done:
            observation, _, _, done, told = environment.step(controller(observation))
        left.append(told["distance"] / start)
        mass = environment.model.pi.detach().reshape(-1, 10)[:, 0].sum().item()
        print(f"arm of {mass:.1f} kg: {100 * left[-1]:.1f} % of the distance is left")
    return max(left)


if __name__ == "__main__":
    main()
