"""Robots that stand for most of the time: what holds them, within what friction may be, is not told and bends nothing.

While a joint rests, tau = gravity + h with any |h| <= c, so a long rest has one unknown and tells next to nothing.
"""

from __future__ import annotations

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import inverse_dynamics, joint_names, multisine, with_wrong_inertials
from vision_head.motion import Motion

import torchrbd

pytestmark = pytest.mark.usefixtures("fit_alone")

SEED, COULOMB, VISCOUS, RATE_HZ = 5, 0.4, 0.5, 125.0
NOISE = np.array([0.5, 0.3, 0.15])
TRUE = random_urdf(SEED, 3, kinds=("revolute",), branching=0.0, massless=0.0)
URDF = with_wrong_inertials(TRUE, SEED)
Table = dict[str, np.ndarray]


def standing(motion: Motion, until_s: float) -> Motion:
    """Return a motion that begins within a second of some time; before, it stands."""
    x = np.clip(motion.t - until_s, 0.0, 1.0)[:, None]
    w, w1, w2 = x**3 * (10 - 15 * x + 6 * x**2), 30 * (x * (1 - x)) ** 2, 60 * x * (1 - x) * (1 - 2 * x)
    qd = w * motion.qd + w1 * motion.q
    return Motion(motion.t, w * motion.q, qd, w * motion.qdd + 2 * w1 * motion.qd + w2 * motion.q)


def recorded(seed: int, duration_s: float, until_s: float) -> Table:
    motion = standing(multisine(3, seed, duration_s=duration_s, rate_hz=RATE_HZ), until_s)
    rng = np.random.default_rng(seed + 1)
    holds = COULOMB * rng.uniform(-1.0, 1.0, 3)
    friction = np.where(motion.qd == 0.0, holds, COULOMB * np.sign(motion.qd) + VISCOUS * motion.qd)
    tau = inverse_dynamics(TRUE, motion) + friction + NOISE * rng.standard_normal(motion.q.shape)
    q = motion.q + 1e-5 * rng.standard_normal(motion.q.shape)
    columns = {"q": q, "tau": tau}
    return {"t": motion.t} | {
        f"{key}_{name}": x[:, j] for key, x in columns.items() for j, name in enumerate(joint_names(TRUE))
    }


@pytest.mark.parametrize(
    "recordings",
    [
        pytest.param([(120.0, 90.0)], id="for 90 of 120 s"),
        pytest.param([(30.0, -1.0), (30.0, 30.0), (30.0, 30.0)], id="in two recordings of three"),
    ],
)
def test_friction_is_found_as_it_is(recordings: list[tuple[float, float]]) -> None:
    tables = [recorded(SEED + k, *each) for k, each in enumerate(recordings)]
    found = torchrbd.identify(URDF.encode(), tables)
    told = [p for p in found.parameters if "coulomb" in p.name]
    assert len(told) == 3
    for p in told:
        assert abs(p.value - COULOMB) < 3.0 * p.std, p
        assert p.std < 0.15, p
