"""The cases of the golden suite: robots, recordings and options.

*Small* arms of three joints run each time. The demo, arms of six and seven joints from the concealed benchmark
(development seeds, its own simulator) and real recordings run by ``make golden``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import real_sets
from concealed.cases import make_case
from robot.random_robots import random_urdf
from simulated import Motion, joint_names, record, with_wrong_inertials

from torchrbd.recordings import Recording

SEED = 0
QUICK = ("friction alone", "a spring", "currents")
# The tiers of the benchmark, with the number of cases of each.
TIERS = {"field": 12, "clean": 6, "null": 6, "outside": 4}


@dataclass(frozen=True)
class Asked:
    """What ``diagnose`` gets."""

    robot: Any
    recordings: Any
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Case:
    """A case by its name; ``make`` writes into a folder what it needs, ``needs_data`` says that it is real."""

    name: str
    make: Callable[[Path], Asked]
    quick: bool = False
    needs_data: bool = False


def demo(_: Path) -> Asked:
    own = files("torchrbd") / "demo"
    robot, fit, holdout = (Path(str(own / name)) for name in ("arm.urdf", "fit.parquet", "holdout.parquet"))
    return Asked(robot, fit, {"holdout": holdout})


ARM = random_urdf(11, 3, kinds=("revolute",))
JOINTS = tuple(joint_names(ARM))


def friction(m: Motion) -> np.ndarray:
    """Return friction that every small arm has and its URDF lacks."""
    return 0.3 * m.qd + 0.4 * np.tanh(m.qd / 0.01)


def at_first(torque: Callable[[Motion], np.ndarray]) -> Callable[[Motion], np.ndarray]:
    """Return a torque of the first joint."""
    return lambda m: np.stack((torque(m), *np.zeros((len(JOINTS) - 1, len(m.t)))), 1)


SMALL: dict[str, Callable[[Motion], np.ndarray]] = {
    "friction alone": friction,
    "a spring": lambda m: friction(m) + at_first(lambda m: 2.0 * (m.q[:, 0] - 0.3))(m),
    "Stribeck friction": lambda m: (
        friction(m) + at_first(lambda m: np.sign(m.qd[:, 0]) * 1.5 * np.exp(-((m.qd[:, 0] / 0.2) ** 2)))(m)
    ),
    "a ripple": lambda m: friction(m) + at_first(lambda m: 0.6 * np.sin(12 * m.q[:, 0] + 0.5))(m),
    "an offset for a time": lambda m: friction(m) + at_first(lambda m: 1.5 * ((m.t > 6.0) & (m.t < 9.0)))(m),
}


def small(extra: Callable[[Motion], np.ndarray], _: Path) -> Asked:
    return Asked(with_wrong_inertials(ARM, 3), _recorded(extra))


def consistent(_: Path) -> Asked:
    return Asked(ARM, record(ARM, 5, duration_s=12.0, rate_hz=100.0))


def _recorded(extra: Callable[[Motion], np.ndarray] = friction, seed: int = 7, name: str = "day") -> Recording:
    return record(ARM, seed, name=name, extra=extra, duration_s=12.0, rate_hz=100.0)


def _arrays(recording: Recording) -> dict[str, np.ndarray]:
    chunk = next(iter(recording.chunks(10**6)))
    return {"t": chunk.t, "q": chunk.q, "tau": chunk.tau}


WRONG: dict[str, Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]] = {
    "degrees": lambda of: {"q": np.degrees(of["q"])},
    "torque with the other sign": lambda of: {"tau": -of["tau"]},
    "two torques exchanged": lambda of: {"tau": of["tau"][:, [1, 0, 2]]},
    "currents": lambda of: {"tau": of["tau"] / 20.0},
}


def wrong(change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]], _: Path) -> Asked:
    """Return a recording that does not mean what its columns say."""
    of = _arrays(_recorded())
    return Asked(ARM, Recording.from_arrays("day", JOINTS, **of | change(of)))


def compared_with_a_simulator(_: Path) -> Asked:
    """The simulator's URDF is right but for a spring."""
    simulated = record(ARM, 7, name="simulated", duration_s=12.0, rate_hz=100.0, torque_noise=0.0)
    return Asked(ARM, _recorded(SMALL["a spring"]), {"simulated": simulated})


def link_encoders(_: Path) -> Asked:
    """The first joint's gear winds up by its torque; a second encoder behind the gear shows it."""
    plain = record(ARM, 7, duration_s=12.0, rate_hz=200.0, extra=friction)
    of = _arrays(plain)
    rng = np.random.default_rng(1)
    wound = of["q"] - of["tau"] * [1 / 2e3, 1e-9, 1e-9]
    return Asked(
        ARM, Recording.from_arrays("day", JOINTS, **of, q_link=wound + 1e-5 * rng.standard_normal(wound.shape))
    )


def concealed(tier: str, index: int, into: Path) -> Asked:
    """Return a case of the concealed benchmark."""
    case = make_case("development", tier, index, SEED)
    (into / "robot.urdf").write_text(case.urdf)
    for name, table in case.recordings.items():
        pq.write_table(table, into / name)
    held_out = [into / name for name in case.recordings if "holdout" in name]
    fitted = [into / name for name in case.recordings if "holdout" not in name]
    return Asked(into / "robot.urdf", fitted, {"holdout": held_out} if held_out else {})


def real(name: str, into: Path) -> Asked:
    data = real_sets.data_folder()
    assert data is not None
    case = real_sets.CASES[name](data, into)
    return Asked(case.robot, case.recordings, dict(case.options) | ({"holdout": case.holdout} if case.holdout else {}))


def every() -> Iterator[Case]:
    """Yield all cases."""
    yield Case("demo", demo)
    yield Case("nothing missing", consistent, quick=True)
    for name, extra in SMALL.items():
        yield Case(name, partial(small, extra), quick=name in QUICK)
    for name, change in WRONG.items():
        yield Case(name, partial(wrong, change), quick=name in QUICK)
    yield Case("simulated pair", compared_with_a_simulator, quick=True)
    yield Case("link encoders", link_encoders, quick=True)
    for tier, count in TIERS.items():
        for index in range(count):
            yield Case(f"{tier} {index}", partial(concealed, tier, index))
    for name in real_sets.CASES:
        yield Case(f"real {name}", partial(real, name), needs_data=True)


CASES = {case.name: case for case in every()}
