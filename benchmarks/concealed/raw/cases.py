"""Make one case of the raw tier."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..cases import Case
from ..robots import SETS, Robot
from ..simulate import Refused
from . import bodies
from .arms import draw_arm, with_wrong_inertials
from .classes import look
from .draws import KINDS, NULLS, WHOLE, draw_effect, largest, small
from .laws import Effect, Motion
from .motion import Way, draw_way
from .plant import STEP, Controller, Friction, Track, simulate
from .sensing import RATE_HZ, Drives, Sensors, recording
from .truth import describe

TIER = "raw"
FIT_S, HOLDOUT_S = 30.0, (15.0, 25.0)
EVERY = round(1 / (RATE_HZ * STEP))
_ATTEMPTS, _ROUNDS, _NEAR = 60, 3, 0.1
# Of the size that is asked for, where the largest plausible strength does not reach it; of the largest torque.
_LEAST, _LEAST_JOINT = 0.25, 0.01
# Log likelihood that an effect must be worth beside rigid body and friction: with less nobody can see it.
_SEEN_NATS = 12.0
_SENSED = ("torque_offset", "torque_scale", "time_delay", "actuator_lag")


@dataclass(frozen=True)
class Options:
    """How raw cases are made.

    Attributes:
        sizes: of effects, in parts of their joint's raw torque; they take turns from round to round.
        inertials: how far those of the URDF are off.
        drives: record set-points in place of torques; all else is the same.
    """

    sizes: Sequence[float] = (0.08,)
    inertials: float = 0.2
    drives: bool = False


def kind_of(index: int, seed: int, of: str) -> tuple[str | None, int]:
    """Return the effect of a case, None for a null, and the number of its round: each holds every effect once."""
    kinds: list[str | None] = [*KINDS, *[None] * NULLS]
    order = np.random.default_rng([seed, SETS.index(of), 4711]).permutation(len(kinds))
    return kinds[order[index % len(kinds)]], index // len(kinds)


def make_case(of: str, index: int, seed: int, options: Options = Options()) -> Case:
    """Make a case, the same of the same arguments; draws that leave their path or miss their size are redrawn."""
    kind, round_ = kind_of(index, seed, of)
    size = options.sizes[round_ % len(options.sizes)]
    refused: list[str] = []
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, SETS.index(of), 4711, index, attempt])
        try:
            case = _draw(rng, of, kind, size, options)
        except Refused as refusal:
            refused.append(str(refusal))
            continue
        name = f"{np.random.default_rng([seed, SETS.index(of), 4711, index, 777]).integers(16**10):010x}"
        own = {"schema": 1, "id": name, "set": of, "tier": TIER, "seed": seed, "index": index, "refused": refused}
        return Case(name, case.urdf, case.recordings, own | case.truth, case.mapping)
    raise RuntimeError(f"{of} {TIER} {index} of seed {seed}: all {_ATTEMPTS} draws refused, e.g. {refused[-1]}")


def _draw(rng: np.random.Generator, of: str, kind: str | None, size: float, options: Options) -> Case:
    robot = draw_arm(rng, of)
    urdf = with_wrong_inertials(rng, robot, options.inertials)
    way = draw_way(rng, robot, FIT_S, 1 / STEP)
    later = draw_way(rng, robot, float(rng.uniform(*HOLDOUT_S)), 1 / STEP)
    friction, x = _friction(rng, robot, way)
    pace = rng.uniform(6.0, 9.0) if kind == "actuator_lag" else rng.uniform(12.0, 28.0)
    give = rng.uniform(0.1, 0.2) if kind == "actuator_lag" else rng.uniform(0.005, 0.03)
    stiffness = np.sqrt(np.mean(x.supplied**2, axis=0)) / give
    controller = Controller(urdf, float(pace), stiffness, float(rng.uniform(0.3, 1.0)))
    effect = None if kind is None else _of_size(draw_effect(rng, kind, robot, x), robot, x, size)
    friction = friction if effect is None else _below(friction, effect)
    track, effect, added = _simulated(robot, friction, effect, way, controller, size)
    if effect is not None:
        effect = _closed(effect, FIT_S)
    held = None if effect is None or effect.window else effect
    holdout = simulate(robot, friction, held, later, controller)
    sensors = Sensors.draw(rng, track.tau[::EVERY])
    drives = Drives.draw(rng.spawn(1)[0], track.tau[::EVERY]) if options.drives else None
    recordings = {}
    for file, one in (("fit_1.parquet", track), ("holdout.parquet", holdout)):
        t, q, tau = one.x.t[::EVERY], one.q[::EVERY], one.tau[::EVERY]
        channel, values = "tau", sensors.torque(rng, t, tau)
        if drives is not None:
            channel, values = "q_ref", drives.set_points(q, one.x.v[::EVERY], tau)
        recordings[file] = recording(robot.joints, t, q, channel, values)
    seen, shares = None, None
    if effect is not None:
        x = sampled(robot, track)
        plain = x.supplied if effect.id in _SENSED else x.supplied - added
        seen = look(
            robot, replace(x, q=track.q[::EVERY], supplied=plain), added, sensors.size, sensors.colour_s, effect
        )
        if seen.nats < _SEEN_NATS:
            raise Refused(f"{effect.id} is hidden by other inertials and friction")
        shares = share(effect, x.t, added, track.tau[::EVERY])
    styles = {"fit_1.parquet": (way.style, FIT_S), "holdout.parquet": (later.style, float(len(later.t) * STEP))}
    facts = {"robot": robot, "inertials": options.inertials, "sensors": sensors, "friction": friction, "size": size}
    truth = describe(facts, styles, effect, shares, seen, sampled(robot, track))
    return Case("", urdf.urdf, recordings, truth, "" if drives is None else drives.mapping(robot.joints))


def sampled(robot: Robot, track: Track) -> Motion:
    """Return what is true at the recorder's samples, with the rigid body's torque."""
    x = track.x
    q, v, a = (s[::EVERY] for s in (x.q, x.v, x.a))
    load = robot.torque(q, v, a)
    return Motion(x.t[::EVERY], q, v, a, load, x.direction[::EVERY], x.supplied[::EVERY])


def _friction(rng: np.random.Generator, robot: Robot, way: Way) -> tuple[Friction, Motion]:
    """Draw friction along a set-point; return the motion that is expected."""
    q, v, a = (s[::EVERY] for s in (way.q, way.v, way.a))
    friction, load = draw_friction(rng, robot, q, v, a), robot.torque(q, v, a)
    supplied = load + friction.torque(v)
    return friction, Motion(way.t[::EVERY], q, v, a, load, friction.direction(v), supplied)


def draw_friction(rng: np.random.Generator, robot: Robot, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Friction:
    """Draw friction of 5 to 20 % of each joint's torque along a motion (N, n)."""
    load, n = robot.torque(q, v, a), robot.n
    torque = np.sqrt(np.mean(load**2, axis=0))
    torque = np.maximum(torque, 0.004 * torque.max())
    total, dry = rng.uniform(0.05, 0.2, n) * torque, rng.uniform(0.35, 0.85, n)
    speed = np.maximum(np.sqrt(np.mean(v**2, axis=0)), 0.05)
    uneven, width = 1 + rng.uniform(-0.12, 0.12, n), np.exp(rng.uniform(np.log(0.002), np.log(0.03), n))
    return Friction(np.sqrt(1 - dry**2) * total / speed, dry * total * uneven, dry * total / uneven, width)


def _below(friction: Friction, effect: Effect) -> Friction:
    """Return friction that is plausible below levels that come on top: at least half as much everywhere."""
    if effect.id not in ("stribeck_friction", "position_dependent_friction", "time_varying_friction"):
        return friction
    least = np.zeros_like(friction.plus)
    least[effect.joint] = 0.5 * effect.strength
    return replace(friction, plus=np.maximum(friction.plus, least), minus=np.maximum(friction.minus, least))


def share(effect: Effect, t: np.ndarray, added: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Return the RMS of an effect's torque over that of the joints' raw torque, (n,), while it acts."""
    rows = bodies.inside(effect, t)
    raw = np.sqrt(np.mean(tau[rows] ** 2, axis=0))
    shares = np.sqrt(np.mean(added[rows] ** 2, axis=0)) / raw
    # Where all joints count, those that carry next to nothing do not.
    heavy = raw > _LEAST_JOINT * raw.max() if effect.id in WHOLE else True
    return np.where(heavy, shares, 0.0)


def reached(effect: Effect, shares: np.ndarray) -> float:
    """Return the size at the joint that counts."""
    return float(shares.max() if effect.joint < 0 or effect.id in WHOLE else shares[effect.joint])


def _of_size(effect: Effect, robot: Robot, x: Motion, size: float) -> Effect:
    """Return the effect of about the size along the expected motion."""
    most = largest(effect, robot)
    effect = effect.of(small(effect, robot))
    for _ in range(4):
        added = bodies.torque(robot, effect, x)
        now = reached(effect, share(effect, x.t, added, x.supplied + added))
        if not now > 1e-9:
            raise Refused(f"{effect.id} does nothing there")
        effect = effect.of(min(most, effect.strength * size / now))
    return effect


def _simulated(
    robot: Robot, friction: Friction, effect: Effect | None, way: Way, controller: Controller, size: float
) -> tuple[Track, Effect | None, np.ndarray]:
    """Simulate, again with another strength while the size is wrong; return the effect's torque at samples too."""
    for _ in range(_ROUNDS):
        track = simulate(robot, friction, effect, way, controller)
        if effect is None:
            return track, None, np.zeros((0, robot.n))
        x = sampled(robot, track)
        added = bodies.torque(robot, effect, x)
        if effect.id in _SENSED:
            added = (track.tau - track.x.supplied)[::EVERY]
        now, most = reached(effect, share(effect, x.t, added, track.tau[::EVERY])), largest(effect, robot)
        limited = effect.strength >= 0.999 * most and now < size
        if abs(now / size - 1) < _NEAR or (limited and now > _LEAST * size):
            return track, effect, added
        effect = effect.of(min(most, effect.strength * size / max(now, 1e-6)))
    raise Refused(f"{effect.id} came to {now:.3f} instead of {size:.3f}")


def _closed(effect: Effect, seconds: float) -> Effect:
    """Return the effect with a window that ends with the recording."""
    if effect.window is None:
        return effect
    return replace(effect, window=(effect.window[0], min(effect.window[1], seconds)))
