"""Play in a gear: named where it is, and where it has no name nothing else is sure."""

from __future__ import annotations

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import inverse_dynamics, joint_names, multisine

import torchrbd
from torchrbd.recordings import Recording

URDF, JOINT = random_urdf(5, 3, kinds=("revolute",), branching=0.0, massless=0.0), 1
PLAY, CROSSING_S, DT = 0.04, 0.03, 0.005


def recorded(play: float, seed: int = 3) -> Recording:
    """Record a robot whose motor at one joint crosses the play of its gear at once as the load changes its sign."""
    motion = multisine(3, seed, duration_s=30.0, rate_hz=1 / DT, fastest_hz=0.5)
    tau = inverse_dynamics(URDF, motion)
    sides, width = np.sign(tau[:, JOINT]), round(CROSSING_S / DT)
    smooth = np.hanning(2 * width + 3)[1:-1]
    ahead = np.convolve(np.pad(sides, width, mode="edge"), smooth / smooth.sum(), mode="valid")
    rng = np.random.default_rng(seed)
    q = motion.q + 1e-5 * rng.standard_normal(motion.q.shape)
    q[:, JOINT] += 0.5 * play * ahead
    tau = tau + 0.02 * np.sqrt(np.mean(tau**2, 0)) * rng.standard_normal(tau.shape)
    return Recording.from_arrays("play", joint_names(URDF), motion.t, q, tau)


@pytest.mark.slow
def test_shocks_without_a_name_are_left_where_they_are() -> None:
    result = torchrbd.diagnose(URDF, recorded(PLAY), exclude=["backlash"], cutoff_hz=10.0)
    joint = joint_names(URDF)[JOINT]
    assert result.verdict in ("unexplained", "missing_physics")
    assert joint in {j for x in (*result.unexplained, *result.locations) for j in x.joints}
    assert max((f.probability for f in result.findings), default=0.0) < 0.9


@pytest.mark.slow
@pytest.mark.parametrize("play", [0.01, PLAY])
def test_play_is_named(play: float) -> None:
    result = torchrbd.diagnose(URDF, recorded(play), cutoff_hz=10.0)
    (found,) = result.findings
    assert (found.effect, found.joints) == ("backlash", (joint_names(URDF)[JOINT],))
    assert found.parameters["backlash"].value == pytest.approx(play, rel=0.2)
    assert result.unexplained == ()
