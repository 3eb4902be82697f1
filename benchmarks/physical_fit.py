"""What physical validity and the prior are worth: torque error on other motions, of nine ways to fit a rigid body.

    OMP_NUM_THREADS=1 python benchmarks/physical_fit.py [SEEDS]

Three arms of 6 and 7 joints, SEEDS seeds each (3 by default). The URDF's bodies are the true ones, changed by about
30 % in every direction. Twenty seconds are recorded, torques by Pinocchio with 3 % noise; with *good data* all joints
move, otherwise half of them hardly do. Judged on noiseless motions of all joints: nmse, mean over joints, geometric
mean over robots and seeds. Needs the test extra.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import import_paths  # noqa: F401
import numpy as np
import torch
from memory import arm
from robot.random_robots import random_urdf
from simulated import Motion, inverse_dynamics, joint_names, multisine
from torch import Tensor

from torchrbd import RobotModel
from torchrbd.dataset.block_statistics import assemble
from torchrbd.inference.estimators.estimate import estimate
from torchrbd.inference.physical.fitting import fit_model
from torchrbd.inference.physical.projection import project, relevance
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.likelihood.equations import linear_fit
from torchrbd.parameters import base_parameters, is_physical
from torchrbd.recordings import Recording
from torchrbd.regression.ard import ard
from torchrbd.robot import from_pseudo_inertia, pseudo_inertia

PRIOR_ERROR, NOISE, STILL, SECONDS = 0.15, 0.03, 1e-3, 20.0


@dataclass(frozen=True)
class Case:
    """A recording, what the fits share, and the motion to judge by."""

    prepared: Prepared
    variance: Tensor
    H: Tensor
    h: Tensor
    urdf: str
    test: Motion


def revolute_arm() -> str:
    """Return the seven-joint arm with joints that Pinocchio gives one coordinate."""
    limits = '<limit lower="-3" upper="3" velocity="3" effort="200"/>'
    return arm().replace('type="continuous"', 'type="revolute"').replace("<axis", limits + "<axis")


def robots() -> list[str]:
    """Return three arms."""
    options = {"kinds": ("revolute",), "branching": 0.0, "massless": 0.0}
    return [revolute_arm(), random_urdf(101, 6, **options), random_urdf(102, 7, **options)]


def wrong(pi: Tensor, rng: np.random.Generator) -> Tensor:
    """Return other physical bodies: J = L (1 + E)(1 + E)' L', with E of ``PRIOR_ERROR``."""
    L = torch.linalg.cholesky(pseudo_inertia(pi.reshape(-1, 10)))
    change = torch.eye(4, dtype=torch.float64) + PRIOR_ERROR * torch.from_numpy(rng.normal(size=(len(L), 4, 4)))
    return from_pseudo_inertia(L @ change @ change.mT @ L.mT).flatten()


def make_case(urdf: str, seed: int, good: bool) -> Case:
    """Record a motion and prepare it."""
    rng, names = np.random.default_rng([seed, 7]), joint_names(urdf)
    size = np.ones(len(names))
    if not good:
        size[rng.permutation(len(names))[: (len(names) + 1) // 2]] = STILL
    motion = multisine(len(names), 1000 + seed, duration_s=SECONDS)
    moved = Motion(motion.t, motion.q * size, motion.qd * size, motion.qdd * size)
    tau = inverse_dynamics(urdf, moved)
    noisy = tau + NOISE * np.sqrt(np.mean(tau**2, 0)) * rng.standard_normal(tau.shape)
    robot = RobotModel.from_urdf(urdf)
    robot.pi = wrong(robot.pi, rng)
    prepared = prepare(robot, [Recording.from_arrays("data", names, motion.t, moved.q, noisy)], Settings(), ())
    _, variance = linear_fit(prepared.training, prepared.prior, prepared.prior.inertial)
    H, h = assemble(prepared.columns, prepared.training.total(), 1.0 / variance)
    n = robot.n_params
    return Case(prepared, variance, H[:n, :n], h[:n], urdf, multisine(len(names), 2000 + seed, duration_s=10.0))


def least_squares(case: Case) -> Tensor:
    """Least squares on the base parameters, in columns of unit length; what no motion tells is zero."""
    base = base_parameters(case.prepared.robot)
    own = torch.tensor(base.independent)
    H, h = case.H[own.unsqueeze(1), own], case.h[own]
    d = H.diagonal().sqrt()
    pi = torch.zeros_like(case.h)
    pi[own] = torch.linalg.lstsq(H / d / d.unsqueeze(1), (h / d).unsqueeze(1), driver="gelsd").solution[:, 0] / d
    return pi


def ridge(case: Case) -> Tensor:
    """Ridge regression of what the URDF leaves on the base parameters, its penalty cross-validated over blocks."""
    return estimate(case.prepared, "ridge").raw[: len(case.h)]


def ridge_in_prior_metric(case: Case) -> Tensor:
    """The quadratic form of the entropic prior around the URDF, kappa 3, without constraint."""
    prior, prepared = case.prepared.prior, case.prepared
    return linear_fit(prepared.training, prior, prior.inertial)[0][: len(case.h)]


def relevance_projection(case: Case) -> Tensor:
    """ARD, then the nearest physical parameters with each weighted by its relevance."""
    statistics = case.prepared.training
    n = float(statistics.torque[..., 0].sum())
    yy = float((statistics.torque[..., 2].sum(0) / case.variance).sum()) / n
    found = ard(case.H / n, case.h / n, yy, n)
    variance = found.covariance.diagonal()
    # At the maximum of the evidence alpha_i (m_i^2 + var_i) = 1.
    alpha = torch.where(variance > 0, 1.0 / (found.mean.square() + variance).clamp_min(1e-300), torch.inf)
    return project(case.prepared.prior, found.mean, relevance(alpha, variance))


def constrained(kappa: float) -> Callable[[Case], Tensor]:
    """The physical fit with the entropic prior."""

    def fitted(case: Case) -> Tensor:
        prepared = prepare_again(case.prepared, kappa)
        return fit_model(prepared.training, prepared.prior).pi

    return fitted


def prepare_again(prepared: Prepared, kappa: float) -> Prepared:
    """Return the same data under a prior of another weight."""
    scale = prepared.prior.scale * (prepared.prior.kappa / kappa) ** 0.5
    return replace(prepared, prior=replace(prepared.prior, kappa=kappa, scale=scale))


METHODS: dict[str, Callable[[Case], Tensor]] = {
    "URDF as given": lambda case: case.prepared.robot.pi,
    "OLS on base parameters": least_squares,
    "ridge to the URDF": ridge,
    "ridge in the prior's metric": ridge_in_prior_metric,
    "ARD, projection by relevance": relevance_projection,
    "OLS, projection in Gram metric": lambda case: project(case.prepared.prior, least_squares(case), case.H),
    "physical fit, kappa 1": constrained(1.0),
    "physical fit, kappa 3": constrained(3.0),
    "physical fit, kappa 10": constrained(10.0),
}


def torque_error(case: Case, pi: Tensor) -> float:
    """Return the nmse of noiseless torques, mean over joints."""
    states = (torch.from_numpy(v) for v in (case.test.q, case.test.qd, case.test.qdd))
    found = case.prepared.robot.inverse_dynamics(*states, pi).numpy()
    truth = inverse_dynamics(case.urdf, case.test)
    return float(np.mean(np.mean((found - truth) ** 2, 0) / truth.var(0)))


def main() -> None:
    """Print the table."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    print(f"{'':32} {'good data':>26}   {'half of the joints still':>26}")
    print(f"{'':32} {'nmse':>9} {'physical':>9} {'s':>6}   {'nmse':>9} {'physical':>9} {'s':>6}  worst")
    cells: dict[str, list[list[tuple[float, bool, float]]]] = {name: [[], []] for name in METHODS}
    for urdf in robots():
        for seed in range(seeds):
            for column, good in enumerate((True, False)):
                case = make_case(urdf, seed, good)
                for name, method in METHODS.items():
                    start = time.perf_counter()
                    pi = method(case)
                    seconds = time.perf_counter() - start
                    physical = bool(is_physical(pi.reshape(-1, 10)).all())
                    cells[name][column].append((torque_error(case, pi), physical, seconds))
    for name, columns in cells.items():
        line = f"{name:32}"
        for results in columns:
            error, physical, seconds = (np.array(v) for v in zip(*results, strict=True))
            line += f" {np.exp(np.log(error).mean()):9.2e} {physical.sum():6d}/{len(error)} {np.median(seconds):6.2f}  "
        print(line + f"{max(e for e, *_ in columns[1]):.1e}")


if __name__ == "__main__":
    main()
