"""Arms whose torques are known, effects drawn where they show best, and two effects of other shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np
import pytest
import torch
from parameters.bodies import random_bodies
from robot.random_robots import random_urdf
from simulated import Motion, inverse_dynamics, joint_names, multisine, with_wrong_inertials

from torchrbd.effects import (
    Effect,
    JointEffect,
    JointScale,
    JointState,
    Shape,
    Signals,
    Site,
    Term,
    Window,
    known_effects,
)
from torchrbd.effects.stribeck_friction import StribeckFriction
from torchrbd.inference.physical.fitting import term_candidates
from torchrbd.inference.physical.terms import term_parameters
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.inference.shapes.refine import fit_with_shapes, refined
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

ALL = known_effects()
DURATION_S, CUTOFF_HZ, REST_PART = 25.0, 20.0, 1e-3
LARGEST_PART, LEAST_PART = 0.2, 0.01
WINDOW = Window("simulated", 8.0, 16.0)


class Truth:
    """A random arm with exact states, and the rigid-body torque that Pinocchio finds for them."""

    def __init__(self, seed: int, n_joints: int = 4, duration_s: float = DURATION_S) -> None:
        self.urdf = random_urdf(seed, n_joints, kinds=("revolute",), branching=0.0, massless=0.0)
        self.robot = RobotModel.from_urdf(self.urdf)
        self.given = RobotModel.from_urdf(with_wrong_inertials(self.urdf, seed, 0.1))
        assert list(self.robot.joint_names) == joint_names(self.urdf)
        self.motion = multisine(n_joints, seed, duration_s=duration_s)
        self.rigid = inverse_dynamics(self.urdf, self.motion)
        states = [torch.from_numpy(x.T.copy()) for x in (self.motion.q, self.motion.qd, self.motion.qdd)]
        width = REST_PART * states[1].abs().amax(1)
        rise = torch.from_numpy(1.0 - np.exp(-self.motion.t / 9.0))
        self.temperature = 25.0 + torch.linspace(12.0, 20.0, n_joints, dtype=torch.float64).unsqueeze(1) * rise
        t = torch.from_numpy(self.motion.t)
        self.signals = Signals(self.robot, *states, width, t=t, recording="simulated", temperature=self.temperature)
        self.scales = [
            JointScale(
                float(qd.abs().max()),
                float(rest),
                float(q.min()),
                float(q.max()),
                float(load),
                duration_s,
                (25.0, 45.0),
            )
            for q, qd, rest, load in zip(*states[:2], width, np.abs(self.rigid).max(0), strict=True)
        ]

    def recording(self, added: np.ndarray) -> Recording:
        m: Motion = self.motion
        names, warm = list(self.robot.joint_names), self.temperature.T.numpy()
        return Recording.from_arrays("simulated", names, m.t, m.q, self.rigid + added, temperature=warm)

    def rows(self, effect: Effect, site: Site, shape: Shape) -> np.ndarray:
        """Return the effect's columns (N n_dof, K) in units of the joints' torque, every eighth sample."""
        found = []
        for phi in effect.features(self.signals, site, shape).values():
            whole = (
                phi
                if effect.whole_robot
                else torch.zeros_like(self.signals.q).index_add(0, torch.tensor([site.joint]), phi.unsqueeze(0))
            )
            found.append((whole.T.numpy() / self.rigid.std(0))[::8].reshape(-1))
        return np.stack(found, -1)

    @cached_property
    def imitable(self) -> np.ndarray:
        """Torques that inertial parameters make: an orthonormal basis (N n_dof, rank)."""
        q, qd, qdd = (torch.from_numpy(x[::8]) for x in (self.motion.q, self.motion.qd, self.motion.qdd))
        Y = self.robot.regressor(q, qd, qdd).numpy() / self.rigid.std(0)[:, None]
        Y = Y.reshape(-1, Y.shape[-1])
        U, s, _ = np.linalg.svd(Y / np.linalg.norm(Y, axis=0).clip(1e-12), full_matrices=False)
        return U[:, s > 1e-7 * s[0]]

    def share_left(self, effect: Effect, site: Site, shape: Shape) -> float:
        """Return which part of the effect's least visible combination no inertial parameters can imitate."""
        phi = self.rows(effect, site, shape)
        size = np.linalg.norm(phi, axis=0)
        if not size.all():
            return 0.0
        phi = phi / size
        return float(np.linalg.svd(phi - self.imitable @ (self.imitable.T @ phi), compute_uv=False)[-1])


def between(truth: Truth, effect: Effect, site: Site, rng: np.random.Generator) -> Shape:
    """Return a shape between two in the middle of the grid; a choice between kinds stays one."""
    grid = effect.shapes(truth.scales[site.joint or 0])
    drawn = dict(grid[rng.integers(len(grid) // 4, max(3 * len(grid) // 4, 1))])
    for name in drawn:
        values = sorted({shape[name] for shape in grid})
        if len(values) > 1 and name not in effect.kinds:
            k = min(max(values.index(drawn[name]), len(values) // 4), max(3 * len(values) // 4 - 1, 0))
            low, moved = values[k], {**drawn, name: values[k] + 0.4 * (values[k + 1] - values[k])}
            same = np.array_equal(truth.rows(effect, site, {**drawn, name: low}), truth.rows(effect, site, moved))
            drawn = drawn if same else moved
    return drawn


def drawn(truth: Truth, effect: Effect, seed: int) -> Term:
    """Draw a term where the effect shows best: a shape, and coefficients that the physics allows."""
    rng = np.random.default_rng(seed)
    sites = [s for s in effect.sites(truth.robot, (WINDOW,)) if effect.shapes(truth.scales[s.joint or 0])]
    if not sites:
        pytest.skip(f"never shows: it needs {effect.needs}")
    for _ in range(10):
        shapes = {site: between(truth, effect, site, rng) for site in sites}
        site = max(sites, key=lambda s: truth.share_left(effect, s, shapes[s]))
        if truth.share_left(effect, site, shapes[site]) == 0.0:
            pytest.skip("never shows: it needs a channel that recordings do not hold")
        size = np.sqrt((truth.rows(effect, site, shapes[site]) ** 2).mean(0))
        for part in np.geomspace(LARGEST_PART, LEAST_PART, 60):
            relative = rng.choice((-1, 1), len(size)) * np.exp(rng.uniform(-3, 0, len(size)))
            # A payload is a body that there may be.
            w = (
                random_bodies(seed, 1, size=0.3)[0]
                if effect.id == "payload"
                else torch.from_numpy(part * relative / size)
            )
            term = Term(effect, site, w, effect.agreeing(w, shapes[site]))
            if effect.plausible(term.parameters_by_name(), truth.scales[site.joint or 0]):
                return term
    raise AssertionError(f"no plausible {effect.id}")


def stribeck(coulomb: float, extra: float, speed: float, joint: int = 1) -> Term:
    w = torch.tensor([coulomb, extra], dtype=torch.float64)
    return Term(StribeckFriction(), Site(joint), w, {"stribeck_speed": speed})


def added_by(term: Term, truth: Truth) -> np.ndarray:
    """Return the torque of a term (N, n_dof)."""
    with torch.no_grad():
        tau = term(truth.signals)
    if term.effect.whole_robot:
        return tau.T.numpy()
    added = np.zeros_like(truth.rigid)
    added[:, term.site.joint] = tau.numpy()
    return added


def told(term: Term, robot: RobotModel) -> str:
    name = f"{term.effect.id}@{term.site.name(robot)}"
    window = term.site.window
    return name if window is None else f"{name}@{window.recording}={window.start_s:g}:{window.end_s:g}"


def recovered(truth: Truth, terms: list[Term], added: np.ndarray, **options) -> list[dict[str, tuple[float, float]]]:
    settings = Settings(effects=tuple(told(t, truth.robot) for t in terms), cutoff_hz=CUTOFF_HZ, **options)
    chosen = settings.chosen_effects()
    prepared = prepare(truth.given, [truth.recording(added)], settings, chosen)
    candidates = term_candidates(prepared.columns, [e.id for e in chosen])
    prepared, found = refined(prepared, candidates, lambda *_: None)
    model = fit_with_shapes(prepared, found)
    by_place = {(c.effect.id, c.site): c for c in found}
    return [term_parameters(model, by_place[t.effect.id, t.site]) for t in terms]


class Ripple(JointEffect):
    """tau += A sin(m q + phase), as a and b."""

    id, words, equation = "test_ripple", "ripple", "a sin(m q) + b cos(m q)"
    units: ClassVar[Mapping[str, str]] = {"a": "{tau}", "b": "{tau}", "order": "1/{q}"}

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return tuple({"order": float(m)} for m in range(5, 25))

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, torch.Tensor]:
        phase = shape["order"] * state.q
        return {f"test sin {shape['order']:.9g}": phase.sin(), f"test cos {shape['order']:.9g}": phase.cos()}

    def parameters(self, coefficients: torch.Tensor, shape: Shape) -> dict[str, torch.Tensor]:
        a, b = coefficients
        return {"a": a, "b": b, "order": coefficients.new_tensor(shape["order"])}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["a"], parameters["b"]), {"order": parameters["order"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return True


class Delay(Effect):
    """tau += share (tau_load(t - delay) - tau_load(t)) of all joints, by linear interpolation."""

    id, words, equation = "test_delay", "delay", "share (tau_load(t - delay) - tau_load(t))"
    units: ClassVar[Mapping[str, str]] = {"share": "1", "delay": "s"}
    whole_robot, uses_load = True, True

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        return (Site(),)

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return tuple({"delay": 0.01 * k} for k in range(1, 8))

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, torch.Tensor]:
        t, delay, load = signals.sequence(), shape["delay"], signals.load
        steps = (delay / (t[1] - t[0])).item()
        whole = int(steps)
        shifted = [torch.cat((load[..., :1].expand(*load.shape[:-1], k), load), -1) for k in (whole, whole + 1)]
        n, part = load.shape[-1], steps - whole
        return {f"test delayed {delay:.9g}": (1 - part) * shifted[0][..., :n] + part * shifted[1][..., :n] - load}

    def parameters(self, coefficients: torch.Tensor, shape: Shape) -> dict[str, torch.Tensor]:
        return {"share": coefficients[0], "delay": coefficients.new_tensor(shape["delay"])}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["share"],), {"delay": parameters["delay"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return True
