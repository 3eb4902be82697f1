"""Speed of the rigid body, as a ratio to Pinocchio called sample by sample from Python.

    OMP_NUM_THREADS=1 python benchmarks/kernels.py [--eager] [--batches 1 64 4096 65536] [--joints 7 30]

Prints tables of time ratios, below 1 is faster. Both sides take turns, the best of some rounds each; float64, one
thread. Pinocchio's side is a plain loop over NumPy rows, at most 4096 of them; its regressors are stored. Forward and
backward is compared to a loop of its analytical derivatives, which are by states alone. Needs the test extra.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pinocchio as pin
import torch
from memory import arm

from torchrbd.model import RigidBodyDynamics
from torchrbd.model.starting import starting_terms
from torchrbd.robot import RobotModel, compiled

ROUNDS, SECONDS, LOOPED = 7, 0.02, 4096
"""Of both sides in turn; that one of ours takes at least; samples that Pinocchio's loop goes through at most."""


def humanoid(n_joints: int) -> str:
    """Return a URDF of a trunk with four limbs, two of its joints slides."""
    axes, trunk = ("0 0 1", "0 1 0", "1 0 0"), n_joints - 4 * (n_joints // 5)
    parents = ["base", *(f"link{k}" for k in range(n_joints - 1))]
    for limb in range(4):
        parents[trunk + limb * (n_joints // 5)] = f"link{trunk // 2 if limb < 2 else trunk - 1}"
    links = "".join(
        f'<link name="link{k}"><inertial><origin xyz="0.01 0.02 0.1"/><mass value="{1 + 0.1 * (k % 7)}"/>'
        f'<inertia ixx="0.03" iyy="0.03" izz="0.01" ixy="0.001" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="joint{k}" type="{"prismatic" if k in (2, n_joints - 1) else "revolute"}">'
        f'<parent link="{parents[k]}"/><child link="link{k}"/><origin xyz="0.05 0 0.2" rpy="0 0.1 0"/>'
        f'<axis xyz="{axes[k % 3]}"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
        for k in range(n_joints)
    )
    return f'<robot name="humanoid"><link name="base"/>{links}</robot>'


class Case:
    """A robot and a batch, on both sides."""

    def __init__(self, urdf: str, samples: int) -> None:
        self.samples = samples
        self.robot = RobotModel.from_urdf(urdf)
        self.module = RigidBodyDynamics(self.robot)
        friction = starting_terms(self.robot, ("viscous_friction", "coulomb_friction"))
        self.rubbing = RigidBodyDynamics(self.robot, terms=friction)
        self.model = pin.buildModelFromXML(urdf)
        self.data = self.model.createData()
        x = np.random.default_rng(0).uniform(-1, 1, (3, samples, self.robot.n_dof))
        self.states = [torch.from_numpy(v if samples > 1 else v[0]) for v in x]
        self.samples_last = [v.reshape(samples, -1).T.contiguous() for v in self.states]
        self.tracked = [v.clone().requires_grad_() for v in self.states]
        self.weight = torch.rand_like(self.states[0])
        looped = min(samples, LOOPED)
        order = [self.model.joints[self.model.getJointId(name)].idx_v for name in self.robot.joint_names]
        position, rates = np.zeros((looped, self.model.nq)), np.zeros((2, looped, self.model.nv))
        rates[:, :, order] = x[1:, :looped]
        for name, values in zip(self.robot.joint_names, x[0, :looped].T, strict=True):
            joint = self.model.joints[self.model.getJointId(name)]
            # A continuous joint is a point on the circle for Pinocchio.
            columns = (values,) if joint.nq == 1 else (np.cos(values), np.sin(values))
            position[:, joint.idx_q : joint.idx_q + joint.nq] = np.stack(columns, -1)
        self.rows = list(zip(position, rates[0], rates[1], strict=True))

    def regressor_loop(self) -> None:
        out = np.empty((min(64, len(self.rows)), self.model.nv, 10 * self.model.nv))
        for k, row in enumerate(self.rows):
            out[k % len(out)] = pin.computeJointTorqueRegressor(self.model, self.data, *row)

    def loop(self, function: Callable[..., object], n_states: int = 3) -> None:
        for row in self.rows:
            function(self.model, self.data, *row[:n_states])

    def without_derivatives(self, function: Callable[..., object], *arguments: torch.Tensor) -> object:
        with torch.no_grad():
            return function(*arguments)

    def forward_and_backward(self) -> None:
        for x in (*self.tracked, self.module.raw_inertia):
            x.grad = None
        self.module(*self.tracked).backward(self.weight)

    def pairs(self) -> Iterator[tuple[str, Callable[[], object], Callable[[], object]]]:
        """Yield names, our side, and Pinocchio's."""
        robot, states = self.robot, self.states
        rnea, crba = partial(self.loop, pin.rnea), partial(self.loop, pin.crba, 1)
        yield "inverse dynamics", lambda: robot.inverse_dynamics(*states), rnea
        yield "the same, to be differentiated", lambda: robot.inverse_dynamics(*self.tracked), rnea
        yield "the same, module", lambda: self.without_derivatives(self.module, *states), rnea
        yield "the same, module with friction", lambda: self.without_derivatives(self.rubbing, *states), rnea
        yield "the same with friction, to be differentiated", lambda: self.rubbing(*self.tracked), rnea
        yield "regressor", lambda: robot.regressor(*states), self.regressor_loop
        yield "the same, samples first in memory", lambda: robot.regressor(*states).contiguous(), self.regressor_loop
        yield "regressor, samples last", lambda: robot.regressor_batch_last(*self.samples_last), self.regressor_loop
        yield "mass matrix", lambda: robot.mass_matrix(states[0]), crba
        yield "forward dynamics", lambda: robot.forward_dynamics(*states), partial(self.loop, pin.aba)
        yield (
            "forward + backward, states and log-Cholesky",
            self.forward_and_backward,
            partial(self.loop, pin.computeRNEADerivatives),
        )


def seconds(call: Callable[[], object], times: int) -> float:
    """Return the time of one of some calls."""
    start = time.perf_counter()
    for _ in range(times):
        call()
    return (time.perf_counter() - start) / times


def ratio(case: Case, ours: Callable[[], object], theirs: Callable[[], object]) -> tuple[float, float]:
    """Return the ratio of the times for a batch, and ours in microseconds a sample."""
    times = max(1, int(SECONDS / max(1e-7, min(seconds(ours, 1) for _ in range(2)))))
    loops = max(1, 1024 // len(case.rows))
    pairs = [(seconds(ours, times) / case.samples, seconds(theirs, loops) / len(case.rows)) for _ in range(ROUNDS)]
    us, them = (min(side) for side in zip(*pairs, strict=True))
    return us / them, 1e6 * us


def main() -> None:
    """Print a table of ratios for each robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--eager", action="store_true", help="torch's own operations instead of the kernels")
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 64, 4096, 65536])
    parser.add_argument("--joints", type=int, nargs="+", default=[7, 30])
    options = parser.parse_args()
    torch.set_num_threads(1)
    if not options.eager and not compiled.is_available():
        parser.error("there is no C compiler, so no kernels: set CC, or measure --eager")
    with compiled.only_eager() if options.eager else contextlib.nullcontext():
        for n_joints in options.joints:
            urdf = arm() if n_joints == 7 else humanoid(n_joints)
            print(f"\n{n_joints} joints: ratio of times (us a sample); load {os.getloadavg()[0]:.1f}")
            table: dict[str, list[str]] = {}
            for samples in options.batches:
                case = Case(urdf, samples)
                for name, ours, theirs in case.pairs():
                    found, us = ratio(case, ours, theirs)
                    table.setdefault(name, []).append(f"{found:.3g} ({us:.3g})")
            print("| | " + " | ".join(map(str, options.batches)) + " |\n|" + " --- |" * (len(options.batches) + 1))
            for name, cells in table.items():
                print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
