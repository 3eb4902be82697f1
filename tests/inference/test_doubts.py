"""Input that can be read but cannot be right is doubted aloud."""

import re
from pathlib import Path

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import joint_names, record

from torchrbd.inference import Fit, identify
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.inference.verdict import verdict_of
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

URDF = random_urdf(31, 3, kinds=("revolute",), branching=0.0, massless=0.0)


@pytest.fixture(scope="module")
def arrays() -> dict[str, np.ndarray]:
    chunk = next(iter(record(URDF, 31).chunks(10**6)))
    return {"t": chunk.t, "q": chunk.q, "tau": chunk.tau}


def notes(arrays: dict[str, np.ndarray], **changes: np.ndarray) -> str:
    found = identify(URDF, Recording.from_arrays("day", joint_names(URDF), **{**arrays, **changes}), effects=[])
    assert found.verdict == ("doubtful" if found.doubts else "identified")
    return "\n".join((*found.doubts, *found.notes))


def test_right_input_is_not_doubted(arrays: dict[str, np.ndarray]) -> None:
    assert notes(arrays, qd=np.gradient(arrays["q"], arrays["t"], axis=0)) == ""


def test_degrees(arrays: dict[str, np.ndarray]) -> None:
    told = notes(arrays, q=np.rad2deg(arrays["q"]))
    assert re.search(r"day is faster than the URDF allows, .*joint3 134 \(limit 5\): check the units of q and t", told)
    assert re.search(r"more than ten times off for joint\d.*: check the units", told)


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


def test_a_temperature_that_some_recordings_lack(arrays: dict[str, np.ndarray]) -> None:
    names, warm = joint_names(URDF), 20.0 + np.ones_like(arrays["q"])
    warm[:, 0] = np.nan
    days = [
        Recording.from_arrays("day", names, **arrays),
        Recording.from_arrays("night", names, temperature=warm, **arrays),
    ]
    prepared = prepare(RobotModel.from_urdf(URDF), days, Settings(), ())
    assert not any(scale.temperature for scale in prepared.columns.scales)
    assert [note for note in prepared.notes if "temperature" in note] == [
        f"day: no temperature of {', '.join(names[1:])}, so that of others is not used there"
    ]


def test_held_out_data_that_are_predicted_worse(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    """Fitted to torques of the wrong sign, judged on right ones."""
    names = joint_names(URDF)
    fitted = Recording.from_arrays("flipped", names, arrays["t"], arrays["q"], -arrays["tau"])
    np.savez(tmp_path / "right.npz", joints=np.array(names), **arrays)
    found = identify(URDF, fitted, holdout=[tmp_path / "right.npz"])
    assert found.verdict == "worse"
    (told,) = (doubt for doubt in found.doubts if "the URDF as given predicts better" in doubt)
    assert all(name in told for name in names)


def test_masses_that_no_link_has(arrays: dict[str, np.ndarray]) -> None:
    assert "masses come out far from the URDF's, link" in notes(arrays, tau=30.0 * arrays["tau"])


def test_masses_of_several_links_may_be_those_of_another_variant(arrays: dict[str, np.ndarray]) -> None:
    """Of one link alone they are not."""
    recording = Recording.from_arrays("day", joint_names(URDF), **arrays)
    far = {}
    for count in (1, 3):
        heavy = re.sub(r'<mass value="([^"]+)"', lambda m: f'<mass value="{12.0 * float(m[1])}"', URDF, count=count)
        (far[count],) = (doubt for doubt in identify(heavy, recording).doubts if "masses come out far" in doubt)
    assert "or is this the URDF of another variant of the robot?" in far[3]
    assert "variant" not in far[1]


def fit(*nmse: float) -> Fit:
    return Fit(dict(zip("ab", nmse, strict=True)), {})


@pytest.mark.parametrize(
    ("urdf", "last", "doubts", "expected"),
    [
        ((0.5, 0.1), (0.1, 0.1), (), "identified"),
        ((0.5, 0.1), (0.1, 0.1), ("units",), "doubtful"),
        ((0.5, 0.1), (0.35, 0.36), (), "identified"),  # 18 % worse
        ((0.5, 0.1), (0.35, 0.40), (), "worse"),  # 25 % worse
        ((0.5, 0.1), (0.35, 0.40), ("units",), "worse"),
    ],
)
def test_verdict(urdf: tuple[float, ...], last: tuple[float, ...], doubts: tuple[str, ...], expected: str) -> None:
    """The last model counts, whatever those before it do."""
    assert verdict_of({"urdf": fit(*urdf), "rigid_body": fit(9.0, 9.0), "extended": fit(*last)}, doubts) == expected


def test_little_explained_on_held_out_data_alone(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    """The held-out torque of one joint is another's: the fit is fine, what it predicts is not."""
    names = joint_names(URDF)
    tau = arrays["tau"].copy()
    tau[:, 2] = 0.3 * np.random.default_rng(0).permutation(tau[:, 2])
    np.savez(tmp_path / "spoilt.npz", joints=np.array(names), **{**arrays, "tau": tau})
    found = identify(URDF, Recording.from_arrays("day", names, **arrays), holdout=[tmp_path / "spoilt.npz"])
    (told,) = found.doubts
    assert re.search(r"explains little of the torque of joint3 \(nmse 0\.00 where it was fitted, \d", told)
    assert found.verdict == "doubtful"


def test_stated_position_noise_that_the_recording_does_not_show(arrays: dict[str, np.ndarray]) -> None:
    q = arrays["q"] + 1e-4 * np.random.default_rng(1).standard_normal(arrays["q"].shape)
    recording = Recording.from_arrays("day", joint_names(URDF), **{**arrays, "q": q})
    stated = {"joint1": 1e-2, "joint2": 1.5e-4, "joint3": 1e-5}
    doubts = identify(URDF, recording, encoder_noise=stated, estimator="physical").doubts
    (told,) = (doubt for doubt in doubts if "not as stated" in doubt)
    rows = re.findall(r"(joint\d) (\S+) rad \(recordings (\S+) rad, (\S+) times (\w+)\)", told)
    assert [(name, float(one), way) for name, one, _, _, way in rows] == [
        ("joint1", 1e-2, "less"),
        ("joint3", 1e-5, "more"),
    ]
    assert [float(seen) for _, _, seen, _, _ in rows] == pytest.approx([1e-4, 1e-4], rel=0.2)
    assert [float(times) for _, _, _, times, _ in rows] == pytest.approx([100.0, 10.0], rel=0.2)
    assert told.endswith("; it is used as stated")
    assert "joint2" not in told
    assert identify(URDF, recording, encoder_noise=1.5e-4).doubts == ()


def test_smoothing_finds_the_position_noise_itself(arrays: dict[str, np.ndarray]) -> None:
    q = arrays["q"] + 3e-3 * np.random.default_rng(2).standard_normal(arrays["q"].shape)
    recording = Recording.from_arrays("day", joint_names(URDF), **{**arrays, "q": q})
    found = identify(URDF, recording, encoder_noise=1e-2)
    assert found.states == "smoothed"
    (told,) = found.doubts
    assert "smoothing finds its own" in told
    for joint, noise in found.noise.items():
        assert noise.position == pytest.approx(3e-3, rel=0.2)
        assert re.search(
            rf"{joint} 0\.01 rad \(recordings [\d.]+ rad, [\d.]+ times less, smoothed {noise.position:.2g} rad", told
        )


@pytest.mark.slow
def test_the_regime_says_what_auto_would_do(arrays: dict[str, np.ndarray]) -> None:
    loud = arrays["q"] + 3e-3 * np.random.default_rng(2).standard_normal(arrays["q"].shape)
    for q, estimator, words in (
        (loud, "wls", "as 'wls' has it; 'auto' would smooth states and parameters together"),
        (loud, "physical", "as 'physical' has it; 'auto' would smooth"),
        (loud, "auto", "states and parameters are smoothed together"),
        (arrays["q"], "smoother", "as 'smoother' has it, 'auto' would filter the states"),
        (arrays["q"], "wls", "states are filtered"),
    ):
        recording = Recording.from_arrays("day", joint_names(URDF), **{**arrays, "q": q})
        found = identify(URDF, recording, estimator=estimator)
        told = found.regime
        assert words in told
        # Where noise biases the fit, the same sentence is a doubt.
        assert (told in found.doubts) == (found.states == "filtered" and q is loud)
        assert ("'auto' would" in told) == ("'auto'" in words)
