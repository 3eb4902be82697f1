"""The experiment: on each seed another robot, recording and noise; every method identifies, every controller acts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from torchrbd import RobotModel, TorchRBDError

from .control import CONTROLLERS, follow
from .methods import CLASSICAL, DEFAULT, Case, Method
from .motion import EYE_HZ, NECK_HZ, RECORDED_EYE_HZ, RECORDED_NECK_HZ, gaze_shifts, multisine
from .robot import URDF, Noise, RealHead, perturbed, record

TRUTH = "true parameters"
MEASURES = {"position": "rad", "velocity": "rad/s", "feedback": "N m"}


@dataclass(frozen=True)
class Conditions:
    """What is the same for all seeds.

    Attributes:
        noise: of the sensors in the recording.
        control_noise: of the encoders in control [rad]. None by default: it would add as much to the error of every
            method, and hide what the parameters cause.
        neck_hz: fastest motion of the neck in the recording.
        effects: what acts on the robot that neither URDF nor methods know of.
        recorded_s, controlled_s: durations of the recording and of each of the two motions that are controlled.
    """

    noise: Noise = field(default_factory=Noise)
    control_noise: float = 0.0
    neck_hz: float = RECORDED_NECK_HZ
    effects: tuple[str, ...] = ()
    recorded_s: float = 30.0
    controlled_s: float = 3.0


@dataclass(frozen=True)
class Results:
    """Errors of all seeds.

    Attributes:
        names: (M,) the methods; the first is the true parameters.
        errors: per controller (S, M, 3) RMS of ``MEASURES``; NaN where a method failed.
        failures: per controller (S, M) why, empty where it did not.
    """

    names: tuple[str, ...]
    errors: dict[str, np.ndarray]
    failures: dict[str, np.ndarray]

    def excess(self, controller: str) -> np.ndarray:
        """Return the median over seeds of the error beyond that of the true parameters, (M, 3); a failure is infinite.

        Infinite is the median too where half the seeds fail.
        """
        errors = self.errors[controller]
        beyond = errors - errors[:, :1]
        return np.median(np.where(np.isnan(beyond), np.inf, beyond), axis=0)

    def best_classical(self, controller: str) -> tuple[list[str], np.ndarray]:
        """Return, for each measure, which classical method has the least median excess, and that (3,)."""
        classical = [k for k, name in enumerate(self.names) if name in CLASSICAL]
        excess = self.excess(controller)[classical]
        return [self.names[classical[k]] for k in excess.argmin(0)], excess.min(0)

    def ratio(self, controller: str) -> np.ndarray:
        """Return the default's median excess in parts of the best classical method's, (3,).

        Where the latter is below zero there are no such parts: 0 if the default's is at most that, else infinite.
        """
        own, best = self.excess(controller)[self.names.index(DEFAULT)], self.best_classical(controller)[1]
        return np.where(best > 0.0, own / np.where(best > 0.0, best, 1.0), np.where(own <= best, 0.0, np.inf))


def run(
    methods: Mapping[str, Method],
    conditions: Conditions,
    seeds: range,
    progress: Callable[[int], None] = lambda _: None,
) -> Results:
    """Run all seeds.

    Args:
        methods: by name.
        conditions: what is the same for all seeds.
        seeds: one robot each.
        progress: told how many seeds are done.
    """
    names = (TRUTH, *methods)
    errors = {name: np.full((len(seeds), len(names), 3), np.nan) for name in CONTROLLERS}
    failures = {name: np.full((len(seeds), len(names)), "", dtype=object) for name in CONTROLLERS}
    for row, seed in enumerate(seeds):
        for controller, (own, why) in run_seed(methods, conditions, seed).items():
            errors[controller][row], failures[controller][row] = own, why
        progress(row + 1)
    return Results(names, errors, failures)


def run_seed(
    methods: Mapping[str, Method], conditions: Conditions, seed: int
) -> dict[str, tuple[np.ndarray, list[str]]]:
    """Return per controller the errors (M, 3) and failures (M,) of the true parameters and of all methods."""
    rng = np.random.default_rng(seed)
    robot = RobotModel.from_urdf(URDF)
    head = RealHead(robot, perturbed(robot, rng), conditions.effects)
    excitation = multisine(rng, conditions.recorded_s, conditions.neck_hz, RECORDED_EYE_HZ)
    case = Case(robot, record(head, excitation, rng, conditions.noise))
    found = [head.pi, *(_tried(method, case) for method in methods.values())]
    there = [k for k, pi in enumerate(found) if isinstance(pi, Tensor)]
    pis = torch.stack([pi for pi in found if isinstance(pi, Tensor)])
    seconds = conditions.controlled_s
    references = [multisine(rng, seconds, NECK_HZ, EYE_HZ), gaze_shifts(rng, seconds)]
    results = {}
    for name, controller in CONTROLLERS.items():
        with torch.no_grad():
            tracking = follow(head, controller, pis, references, conditions.control_noise, seed)
        errors, failures = np.full((len(found), 3), np.nan), [str(pi) for pi in found]
        errors[there] = tracking.errors
        for k, why in zip(there, tracking.failures, strict=True):
            failures[k] = why
        results[name] = errors, failures
    return results


def _tried(method: Method, case: Case) -> Tensor | str:
    """Return a method's parameters (n_params,), or why it has none."""
    try:
        pi = method(case)
    except (TorchRBDError, RuntimeError) as error:
        return f"no estimate: {error}"
    return pi if bool(torch.isfinite(pi).all()) else "no estimate: not finite"
