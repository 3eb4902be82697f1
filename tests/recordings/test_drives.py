"""Torques of position drives: tau = clip(kp (q_ref - q) - kd qd)."""

from __future__ import annotations

import numpy as np
import pytest

from torchrbd.errors import RecordingError
from torchrbd.recordings import Chunk, Recording, open_recording, read_mapping, survey
from torchrbd.recordings.clock import uniform_blocks

JOINTS = ("hip", "knee")
DT, ROWS = 0.005, 400
T = DT * np.arange(ROWS)


def motion() -> dict[str, np.ndarray]:
    """Return columns of two joints that follow set-points with an error; only the hip's velocity is recorded."""
    q = np.stack((0.4 * np.sin(3 * T), 0.3 * np.cos(2 * T)), 1)
    q_ref = np.stack((0.5 * np.sin(3 * T + 0.2), 0.35 * np.cos(2 * T + 0.1)), 1)
    columns = {"t": T, "qd_hip": 1.2 * np.cos(3 * T) + 0.01}
    for k, joint in enumerate(JOINTS):
        columns |= {f"q_{joint}": q[:, k], f"q_ref_{joint}": q_ref[:, k]}
    return columns


def opened(tmp_path, text: str, columns: dict[str, np.ndarray] | None = None, **options) -> Recording:
    path = tmp_path / "map.yaml"
    path.write_text(text)
    return open_recording(columns or motion(), JOINTS, mapping=read_mapping(path), **options)


def joined(recording: Recording, rows: int = 10**6) -> Chunk:
    parts = list(recording.chunks(rows))
    stacked = {name: [getattr(one, name) for one in parts] for name in ("t", "q", "tau", "q_ref", "qd")}
    return Chunk(**{name: None if x[0] is None else np.concatenate(x) for name, x in stacked.items()})


BOTH = "joints: {hip: {drive: {kp: 20, kd: 1.5}}, knee: {drive: {kp: 30, kd: 0.5, limit: 1.2}}}"


def test_torque_of_the_law_with_the_recorded_velocity_or_differences(tmp_path):
    x, found = motion(), joined(opened(tmp_path, BOTH))
    hip = 20 * (x["q_ref_hip"] - x["q_hip"]) - 1.5 * x["qd_hip"]
    q = x["q_knee"]
    speed = np.r_[q[1] - q[0], (q[2:] - q[:-2]) / 2, q[-1] - q[-2]] / DT
    knee = np.clip(30 * (x["q_ref_knee"] - q) - 0.5 * speed, -1.2, 1.2)
    np.testing.assert_allclose(found.tau, np.stack((hip, knee), 1), rtol=1e-9, atol=1e-9)
    assert (np.abs(found.tau[:, 1]) == 1.2).any()


@pytest.mark.parametrize("delay", [0.0, 0.013, -0.008])
@pytest.mark.parametrize("rows", [1, 7, 64])
def test_chunks_do_not_matter(tmp_path, rows, delay):
    recording = opened(tmp_path, f"set_point_delay: {delay}\n{BOTH}")
    np.testing.assert_allclose(joined(recording, rows).tau, joined(recording).tau, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("delay", [0.01, -0.02])
def test_set_points_are_followed_later(tmp_path, delay):
    x, found = motion(), joined(opened(tmp_path, f"set_point_delay: {delay}\n{BOTH}"))
    late = np.interp(T - delay, T, x["q_ref_hip"])
    np.testing.assert_allclose(found.tau[:, 0], 20 * (late - x["q_hip"]) - 1.5 * x["qd_hip"], rtol=1e-9, atol=1e-9)


def test_a_drive_of_every_joint_but_those_with_a_torque(tmp_path):
    text = "joints: {'*': {drive: {kp: 5}}, knee: {tau: knee_torque}}"
    found = opened(tmp_path, text, motion() | {"knee_torque": 3.0 * T})
    assert list(found.drives.of) == ["hip"]
    assert found.measured.all()
    assert found.source("tau", "hip") is None
    np.testing.assert_allclose(joined(found).tau[:, 1], 3.0 * T)


def test_a_joint_without_set_point_and_torque_is_not_measured(tmp_path):
    x = {name: column for name, column in motion().items() if name != "q_ref_knee"}
    found = opened(tmp_path, "joints: {hip: {drive: {kp: 5, kd: 0.1}}}", x)
    assert found.measured.tolist() == [True, False]
    assert found.referenced.tolist() == [True, False]
    assert not found.has_reference
    assert np.isnan(joined(found).tau[:, 1]).all()
    block = next(uniform_blocks(found, survey(found).clock))
    assert block.q_ref is not None
    assert len(block.q_ref) == 1


def test_a_recorded_torque_is_not_used_where_there_is_a_drive(tmp_path):
    found = opened(tmp_path, BOTH, motion() | {"tau_hip": 7.0 + T})
    assert joined(found).tau[0, 0] != 7.0
    assert "tau_hip" in str(found.notes)


def test_order_of_the_joints(tmp_path):
    found = opened(tmp_path, BOTH)
    other = found.of_joints(JOINTS[::-1])
    np.testing.assert_array_equal(joined(other).tau, joined(found).tau[:, ::-1])
    np.testing.assert_array_equal(other.drives.stiffness, [30.0, 20.0])
    np.testing.assert_array_equal(other.drives.limits, [1.2, np.inf])


def test_jumps_by_whole_turns_are_no_torque(tmp_path):
    x = motion()
    x["q_ref_hip"] = x["q_ref_hip"] + 3.0 * T
    x["q_hip"] = x["q_hip"] + 3.0 * T
    expected = joined(opened(tmp_path, BOTH, x)).tau
    wrapped = x | {name: (x[name] + np.pi) % (2 * np.pi) - np.pi for name in ("q_hip", "q_ref_hip")}
    assert np.abs(np.diff(wrapped["q_hip"])).max() > 6.0
    np.testing.assert_allclose(joined(opened(tmp_path, BOTH, wrapped)).tau, expected, atol=1e-9)
    np.testing.assert_allclose(joined(opened(tmp_path, BOTH, wrapped), 7).tau, expected, atol=1e-9)


def test_missing_rows_make_no_torque_there(tmp_path):
    x = motion()
    x["q_ref_hip"][50:53] = np.nan
    found = joined(opened(tmp_path, BOTH, x)).tau
    assert np.flatnonzero(np.isnan(found[:, 0])).tolist() == [50, 51, 52]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("joints: {hip: {drive: {kd: 2}}}", r"joints\.hip\.drive: a drive needs its stiffness kp"),
        ("joints: {hip: {drive: {kp: 0}}}", r"joints\.hip\.drive\.kp: expected a number above 0, got 0"),
        ("joints: {hip: {drive: {kp: 2, kd: -1}}}", r"joints\.hip\.drive\.kd: expected 0 or more, got -1"),
        ("joints: {hip: {drive: {kp: 2, limit: -1}}}", r"drive\.limit: expected a number above 0"),
        ("joints: {hip: {drive: {kp: 2, damping: 1}}}", r"unknown key 'damping'"),
        ("joints: {hip: {drive: {kp: 2}, tau: a}}", r"joints\.hip: give 'tau' or 'drive', not both"),
        ("joints: {foot: {drive: {kp: 2}}}", r"the robot has no joint 'foot'"),
        ("set_point_delay: 30\njoints: {hip: {drive: {kp: 2}}}", r"set_point_delay: expected seconds"),
    ],
)
def test_mistakes(tmp_path, text, message):
    with pytest.raises(RecordingError, match=message):
        opened(tmp_path, text)


def test_a_drive_without_its_set_point_says_so(tmp_path):
    x = {name: column for name, column in motion().items() if name != "q_ref_knee"}
    with pytest.raises(RecordingError, match=r"missing columns: q_ref_knee, the set-points that drives follow"):
        opened(tmp_path, BOTH, x)


def test_without_torque_the_message_names_drives(tmp_path):
    with pytest.raises(RecordingError, match=r"no joint has a torque.*give their gains in a mapping"):
        opened(tmp_path, "{torque_delay: 0}")
