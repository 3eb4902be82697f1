"""Make one case: draw a robot, motions and strengths for its plan, simulate, measure sizes, add the sensors' noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from . import tiers
from .absorbed import absorbed_effect
from .background import Background
from .contract import Effect, Window
from .effects import EFFECTS
from .motion import KINDS, Motion, Path, draw_path, draw_temperature, expected, finer, temperature_at
from .recorder import noise_of, table
from .robots import SETS, Robot, draw_robot
from .simulate import STEP, Controller, Refused, Run, simulate
from .sizes import RATE_HZ, Yardstick
from .truth import Measured, describe

EVERY = round(1 / (RATE_HZ * STEP))
_ATTEMPTS, _EASIER_AFTER = 48, 12
# How near to the size that was asked for, and simulations until it is reached; what resonates or hunts jumps about.
_NEAR, _NEAR_JUMPY, _ROUNDS = 0.15, 0.3, 4
FIT_S, HALVES_S, HOLDOUT_S = 30.0, 20.0, 15.0
"""Length of the one recording to fit, of each if there are two, and of the one that is held out."""
_WINDOWED = ("payload", "external_wrench")


@dataclass(frozen=True)
class Case:
    """All files of a case.

    Attributes:
        id: tells nothing.
        urdf: what the tool is given.
        recordings: by file name.
        truth: for the scorer.
        mapping: the file that states the robot's drives; empty if torques are recorded.
    """

    id: str
    urdf: str
    recordings: dict[str, pa.Table]
    truth: dict[str, Any]
    mapping: str = ""


@dataclass(frozen=True)
class Take:
    """One recording to be made: its path at every step and temperatures (N, n)."""

    file: str
    kind: str
    path: Path
    temperature: np.ndarray


def make_case(of: str, tier: str, index: int, seed: int) -> Case:
    """Make a case; the same arguments make the same case.

    Draws that are unstable or that cannot reach their size plausibly are thrown away; after some, smaller sizes do.

    Args:
        of: "development" or "final".
        tier: one of ``tiers.TIERS``.
        index: of the case in its tier.
        seed: of the set.
    """
    numbers = [seed, SETS.index(of), tiers.TIERS.index(tier), index]
    wanted = tiers.plan(tier, index, seed, SETS.index(of))
    reasons = []
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([*numbers, attempt])
        smaller = attempt // _EASIER_AFTER
        sizes = [tiers.SIZES[max(0, tiers.SIZES.index(size) - smaller)] for size in wanted.sizes]
        try:
            case = _draw(rng, of, wanted, sizes)
        except Refused as refusal:
            reasons.append(str(refusal))
            continue
        name = f"{np.random.default_rng([*numbers, 777]).integers(16**10):010x}"
        truth = {"schema": 1, "id": name, "set": of, "tier": tier, "seed": seed, "index": index, "refused": reasons}
        return Case(name, case.urdf, case.recordings, truth | case.truth)
    raise RuntimeError(f"{of} {tier} {index} of seed {seed}: all {_ATTEMPTS} draws refused, e.g. {reasons[-1]}")


def _draw(rng: np.random.Generator, of: str, wanted: tiers.Plan, sizes: Sequence[float]) -> Case:
    robot = draw_robot(rng, of)
    if len(wanted.kinds) > robot.n:
        raise Refused("more effects than joints")
    error = float(rng.uniform(0.0, 0.3))
    urdf = robot.with_cad_error(int(rng.integers(2**31)), error)
    held = int(rng.integers(robot.n)) if "spring_at_a_fixed_angle" in wanted.kinds else None
    takes = _takes(rng, robot, windowed=any(kind in _WINDOWED for kind in wanted.kinds), held=held)
    along = [_expected(robot, take) for take in takes if take.file != "holdout.parquet"]
    background = Background.draw(rng, along[0]) if wanted.conditions.background else Background.none(robot.n)
    yardstick = Yardstick(along, [x.load + background.torque(x) for x in along])
    effects = _effects(rng, wanted, sizes, yardstick, held)
    controller = _controller(rng, urdf, along[0], wanted)
    targets = [None] * len(effects) if wanted.tier == "absorbed" else list(sizes)
    runs, measured = _simulated(robot, effects, background, controller, takes, targets)
    fits = [run for run in runs if run.file != "holdout.parquet"]
    effects = [m.effect for m in measured if not m.background]
    noise = noise_of(rng, wanted.conditions, fits, effects)
    shows_temperature = "thermal_viscosity" in wanted.kinds or rng.random() < 0.2
    recordings = {run.file: table(rng, run, effects, robot.joints, noise, shows_temperature) for run in runs}
    facts = {"expected": wanted.expected, "robot": robot, "cad_error": error, "noise": noise}
    kinds = {take.file: take.kind for take in takes}
    return Case("", urdf.urdf, recordings, describe(facts, runs, kinds, measured))


def _takes(rng: np.random.Generator, robot: Robot, *, windowed: bool, held: int | None) -> list[Take]:
    """Draw the recordings: one or two to fit, one to hold out."""
    seconds = [HALVES_S, HALVES_S] if rng.random() < (0.5 if windowed else 0.15) else [FIT_S]
    files = [(f"fit_{k + 1}.parquet", s) for k, s in enumerate(seconds)] + [("holdout.parquet", HOLDOUT_S)]
    takes, start = [], None
    for file, duration in files:
        kind = str(rng.choice(KINDS))
        path = draw_path(rng, robot, kind, duration, 1 / STEP, held)
        if held is not None:
            # Held at one and the same angle in all recordings.
            start = path.q[0, held] if start is None else start
            path.q[:, held] = start
        takes.append(Take(file, kind, path, temperature_at(draw_temperature(rng, robot.n), path.t)))
    return takes


def _expected(robot: Robot, take: Take) -> Motion:
    return expected(robot, take.path.every(EVERY), take.file, take.temperature[::EVERY])


def _controller(rng: np.random.Generator, urdf: Robot, x: Motion, wanted: tiers.Plan) -> Controller:
    """Draw a controller; where something lies between motor and link it must be slow or know nothing of the link."""
    held, free = x.robot.inertias(x.q)
    pace = rng.uniform(8.0, 14.0) if "actuator_lag" in wanted.kinds else rng.uniform(15.0, 35.0)
    apart = {"joint_elasticity", "backlash"} & set(wanted.kinds)
    return Controller(urdf, np.sqrt(held * free), float(pace), bool(rng.random() < 0.5) and not apart)


def _effects(
    rng: np.random.Generator, wanted: tiers.Plan, sizes: Sequence[float], yardstick: Yardstick, held: int | None
) -> list[Effect]:
    """Draw the effects of a plan, each at a joint of its own and as strong as its size asks."""
    x = yardstick.motions[0]
    if wanted.tier == "absorbed":
        return [absorbed_effect(rng, wanted.kinds[0], sizes[0], yardstick, held)]
    effects: list[Effect] = []
    for kind, size in zip(wanted.kinds, sizes, strict=True):
        taken = {effect.joint for effect in effects}
        free = [j for j in yardstick.joints if j not in taken]
        for joint in rng.permutation(free)[:3].tolist():
            effect = EFFECTS[kind].draw(rng, x, joint)
            effect.window = _window(rng, yardstick.motions) if kind in _WINDOWED else None
            try:
                effects.append(yardstick.scaled(effect, size))
                break
            except Refused:
                continue
        else:
            raise Refused(f"{kind} cannot be of size {size} at any of three joints")
    return effects


def _window(rng: np.random.Generator, motions: Sequence[Motion]) -> Window:
    """Draw the whole of the last recording where there are several, or a part of one."""
    x = motions[-1]
    if len(motions) > 1 and rng.random() < 0.7:
        return Window(x.file, -np.inf, np.inf)
    length, end = float(rng.uniform(5.0, 12.0)), float(x.t[-1])
    start = float(rng.uniform(1.5, end - length - 1.5))
    return Window(x.file, round(start, 2), round(start + length, 2))


def _simulated(
    robot: Robot,
    effects: Sequence[Effect],
    background: Background,
    controller: Controller,
    takes: Sequence[Take],
    targets: Sequence[float | None],
) -> tuple[list[Run], list[Measured]]:
    """Simulate and measure, again with strengths set right while sizes come out wrong; the last take is held out.

    Raises:
        Refused: the robot left its path, or sizes stayed wrong.
    """

    known = [_feed_forward(controller, robot, background, take) for take in takes]

    def run(k: int) -> Run:
        take = takes[k]
        setting = (take.path, controller, known[k], take.file, take.temperature)
        return simulate(robot, background, effects, *setting)

    for _ in range(_ROUNDS):
        fits = [run(k) for k in range(len(takes) - 1)]
        measured = _measure(robot, fits, effects, background, targets)
        found = [m for m in measured if m.role == "effects"]
        ratios = [m.target / m.reached if m.target else 1.0 for m in found]
        near = [_NEAR_JUMPY if m.effect.by_difference else _NEAR for m in found]
        if all(abs(ratio - 1.0) < close for ratio, close in zip(ratios, near, strict=True)):
            return [*fits, run(-1)], measured
        effects = [m.effect.of_strength(m.effect.strength * ratio) for m, ratio in zip(found, ratios, strict=True)]
        if any(e.strength > e.limit(m.motion) for e, m in zip(effects, found, strict=True)):
            break
    raise Refused("sizes differ in the simulation: " + ", ".join(f"{m.effect.id} {m.reached:.3f}" for m in found))


def _feed_forward(controller: Controller, robot: Robot, background: Background, take: Take) -> np.ndarray:
    """Return (N, n): friction of the background along the set-point, and for PD the rigid body's torque by the URDF."""
    x = _expected(robot, take)
    torque = background.compensation(x.qd)
    if not controller.computed:
        torque += controller.urdf.torque(x.q, x.qd, x.qdd)
    return finer(x.t, torque, take.path.t)


def _measure(
    robot: Robot,
    runs: Sequence[Run],
    effects: Sequence[Effect],
    background: Background,
    targets: Sequence[float | None],
) -> list[Measured]:
    """Measure all effects along fit recordings; concealed ones first."""
    fits = [run.motion(robot, effects, EVERY) for run in runs]
    yardstick = Yardstick([x for x, _ in fits], [tau for _, tau in fits])
    companions = [friend for effect in effects for friend in effect.companions()]
    all_of_them = [*effects, *companions, *background.parts()]
    found = []
    for effect, target in zip(all_of_them, [*targets, *[None] * len(all_of_them[len(targets) :])], strict=True):
        torques = [effect.torque(x) for x, _ in fits]
        if effect.by_difference:
            rest = [e for e in all_of_them if e is not effect]
            torques = [tau - x.load - sum(e.torque(x) for e in rest) for x, tau in fits]
        size = yardstick.size(torques, effect.beside_friction, effect.window)
        role = "effects" if effect in effects else "companions" if effect in companions else "background"
        reached, raw = (yardstick.largest(effect, sizes) for sizes in (size.left, size.raw))
        found.append(Measured(effect, role, target, size, reached, raw, fits[0][0]))
    return found
