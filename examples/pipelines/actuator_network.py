"""A network learns a drive from recordings, and stands for it in a MuJoCo loop as Isaac Lab's ActuatorNetMLP does.

The drives of a two-joint arm follow position targets by gains, but the torque arrives late, is limited, and loses dry
friction in the gear. A simulator that takes the gains at their word moves otherwise. The network sees position errors
and velocities of three steps, a row per joint, and gives the torque; the robot itself is the MJCF of ``to_mjcf``.
Needs MuJoCo: ``pip install torchrbd[examples]``.

    python examples/pipelines/actuator_network.py
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import torch
from torch import nn

import torchrbd

URDF = """<robot name="leg"><link name="base"/>
<joint name="hip" type="revolute"><parent link="base"/><child link="thigh"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" effort="40" velocity="20"/></joint>
<link name="thigh"><inertial><origin xyz="0 0 -0.15"/><mass value="2.0"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="knee" type="revolute"><origin xyz="0 0 -0.3"/><parent link="thigh"/>
  <child link="shank"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" effort="40" velocity="20"/></joint>
<link name="shank"><inertial><origin xyz="0 0 -0.12"/><mass value="1.0"/>
  <inertia ixx="0.008" iyy="0.008" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
KP, KD = 60.0, 1.5  # N m/rad, N m s/rad
DT, SECONDS = 0.005, 20.0
BACK = (0, 2, 4)  # steps, as the configuration's input_idx
POS_SCALE, VEL_SCALE, TORQUE_SCALE = 5.0, 0.2, 20.0

# Torque (2,) of histories of errors and velocities (steps, 2), the present step first.
Drive = Callable[[np.ndarray, np.ndarray], np.ndarray]


class RealDrive:
    """What nobody wrote down: torque lags by 15 ms, ends at 18 N m, and 1.5 N m of it stay in the gear."""

    LAG, LIMIT, FRICTION = 0.015, 18.0, 1.5

    def __init__(self) -> None:
        self._torque = np.zeros(2)

    def __call__(self, errors: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        wanted = np.clip(KP * errors[0] - KD * speeds[0], -self.LIMIT, self.LIMIT)
        self._torque = self._torque + (wanted - self._torque) * DT / self.LAG
        return self._torque - self.FRICTION * np.tanh(speeds[0] / 0.05)


def ideal(errors: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Return the torque of the gains."""
    return KP * errors[0] - KD * speeds[0]


class LearntDrive:
    """A TorchScript file, fed as Isaac Lab feeds it."""

    def __init__(self, file: Path) -> None:
        self._network = torch.jit.load(file)

    @torch.no_grad()
    def __call__(self, errors: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        return TORQUE_SCALE * self._network(torch.from_numpy(rows(errors, speeds))).numpy().ravel()


def rows(errors: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Return a row of scaled inputs for each joint, (2, 2 n_history), of histories (steps, 2)."""
    at = list(BACK)
    return np.concatenate((POS_SCALE * errors[at], VEL_SCALE * speeds[at])).T.astype(np.float32)


def targets(seed: int) -> np.ndarray:
    """Return position targets (N, 2) [rad]: sums of sines up to 1.5 Hz, and steps."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, SECONDS, DT)
    f, a, p = (rng.uniform(low, high, (6, 1, 2)) for low, high in ((0.1, 1.5), (0.05, 0.2), (0.0, 2.0 * np.pi)))
    steps = np.repeat(rng.uniform(-0.4, 0.4, (len(t) // 200, 2)), 200, axis=0)
    return (a * np.sin(2.0 * np.pi * f * t[:, None] + p)).sum(0) + steps


def simulate(mjcf: bytes, drive: Drive, target: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions (N, 2), inputs (N, 2, 2 n_history) and torques (N, 2) of an arm that follows its targets."""
    model = mujoco.MjModel.from_xml_string(mjcf)
    model.opt.timestep = DT
    data = mujoco.MjData(model)
    errors, speeds = np.zeros((2, max(BACK) + 1, 2))
    found = [], [], []
    for wanted in target:
        for history, new in ((errors, wanted - data.qpos), (speeds, data.qvel)):
            history[1:] = history[:-1].copy()
            history[0] = new
        tau = drive(errors, speeds)
        for own, new in zip(found, (data.qpos.copy(), rows(errors, speeds), tau), strict=True):
            own.append(new)
        data.qfrc_applied[:] = tau
        mujoco.mj_step(model, data)
    return tuple(np.stack(x) for x in found)


def learn(inputs: np.ndarray, torques: np.ndarray) -> nn.Module:
    """Return a network of inputs (M, 2 n_history) that gives torques (M,) over ``TORQUE_SCALE``."""
    torch.manual_seed(0)
    x, y = torch.from_numpy(inputs), torch.from_numpy((torques / TORQUE_SCALE).astype(np.float32))
    layers = (nn.Linear(x.shape[1], 32), nn.Softsign(), nn.Linear(32, 32), nn.Softsign(), nn.Linear(32, 1))
    network, steps = nn.Sequential(*layers), 1500
    optimiser = torch.optim.Adam(network.parameters(), lr=5e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        some = torch.randint(len(x), (512,))
        optimiser.zero_grad()
        (network(x[some]).squeeze(1) - y[some]).square().mean().backward()
        optimiser.step()
        schedule.step()
    return network


def main() -> float:
    """Learn from one motion, and return how far another is off, as a part of what the ideal drive is."""
    robot = torchrbd.RigidBodyDynamics.from_urdf(URDF.encode())
    mjcf = torchrbd.to_mjcf(robot)
    _, inputs, torques = simulate(mjcf, RealDrive(), targets(0))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "drive.pt"
        torchrbd.to_actuator_net(learn(inputs.reshape(-1, inputs.shape[2]), torques.ravel()), file, n_history=len(BACK))
        drives: dict[str, Drive] = {"real": RealDrive(), "ideal": ideal, "learnt": LearntDrive(file)}
        motion = {name: simulate(mjcf, drive, targets(1))[0] for name, drive in drives.items()}
    off = {name: np.sqrt(np.square(q - motion["real"]).mean()) for name, q in motion.items()}
    print(
        f"positions differ from the real arm's by {1e3 * off['ideal']:.1f} mrad where the gains are taken at their word"
    )
    print(f"and by {1e3 * off['learnt']:.1f} mrad with the network")
    return float(off["learnt"] / off["ideal"])


if __name__ == "__main__":
    main()
