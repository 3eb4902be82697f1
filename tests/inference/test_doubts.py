"""Input that can be read but cannot be right is doubted aloud."""

from pathlib import Path

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import joint_names, record

from torchrbd.inference import identify
from torchrbd.recordings import Recording

URDF = random_urdf(31, 3, kinds=("revolute",), branching=0.0, massless=0.0)


@pytest.fixture(scope="module")
def arrays() -> dict[str, np.ndarray]:
    chunk = next(iter(record(URDF, 31).chunks(10**6)))
    return {"t": chunk.t, "q": chunk.q, "tau": chunk.tau}


def notes(arrays: dict[str, np.ndarray], **changes: np.ndarray) -> str:
    return "\n".join(identify(URDF, Recording.from_arrays("day", joint_names(URDF), **{**arrays, **changes})).notes)


def test_right_input_is_not_doubted(arrays: dict[str, np.ndarray]) -> None:
    assert notes(arrays, qd=np.gradient(arrays["q"], arrays["t"], axis=0)) == ""


def test_degrees(arrays: dict[str, np.ndarray]) -> None:
    told = notes(arrays, q=np.rad2deg(arrays["q"]))
    assert "its limit is 5: check the units of q and t" in told
    assert "more than ten times off: check the units" in told


def test_velocity_that_is_not_the_derivative(arrays: dict[str, np.ndarray]) -> None:
    qd = np.gradient(arrays["q"], arrays["t"], axis=0)
    qd[:, 1] = np.rad2deg(qd[:, 1])
    assert "qd_joint2 is 57.3 times dq/dt and not used" in notes(arrays, qd=qd)


def test_bad_samples(arrays: dict[str, np.ndarray]) -> None:
    q, tau = arrays["q"].copy(), arrays["tau"].copy()
    q[3000, 0] += 40.0
    tau[2000, 2] = 1e6
    told = notes(arrays, q=q, tau=tau)
    assert "q_joint1 jumps" in told
    assert "tau_joint3 peaks at 1e+06" in told


def test_torque_that_never_changes(arrays: dict[str, np.ndarray]) -> None:
    tau = arrays["tau"].copy()
    tau[:, 1] = 0.0
    assert "the torque of joint2 never changes and is not used" in notes(arrays, tau=tau)


def test_held_out_data_that_are_predicted_worse(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    """Fitted to torques of the wrong sign, judged on right ones."""
    names = joint_names(URDF)
    fitted = Recording.from_arrays("flipped", names, arrays["t"], arrays["q"], -arrays["tau"])
    np.savez(tmp_path / "right.npz", joints=np.array(names), **arrays)
    told = "\n".join(identify(URDF, fitted, holdout=[tmp_path / "right.npz"]).notes)
    assert all(f"on held-out data {joint} is predicted worse than by the URDF" in told for joint in names)


def test_masses_that_no_link_has(arrays: dict[str, np.ndarray]) -> None:
    assert "times the URDF's: a load" in notes(arrays, tau=30.0 * arrays["tau"])
