"""The set-point of a controller, where a recording has it: streamed and filtered next to q."""

import numpy as np
import pyarrow as pa
import pytest
import torch
from pyarrow import csv, parquet
from recordings.motion import JOINTS, clean_recording, motion, torque

from torchrbd.errors import RecordingError
from torchrbd.recordings import Filtering, Recording, open_recording, read_mapping, survey, tiles

CLOCK = np.arange(0, 12, 0.004)
FILTERING = Filtering(6.0)


def references(recording, rows=4096):
    """Return q_ref, qd_ref, qdd_ref of all tiles (3, n, N), decimated."""
    parts = []
    for part in tiles(recording, survey(recording), FILTERING, rows):
        assert part.reference is not None
        parts.append(part.decimate(torch.stack(part.reference)))
    return torch.cat(parts, dim=-1).numpy()


def raw(recording):
    chunks = list(recording.chunks())
    assert all(chunk.q_ref is not None for chunk in chunks)
    return np.concatenate([chunk.q_ref for chunk in chunks])


def test_set_points_are_read_from_every_format(tmp_path):
    q, tau, q_ref = motion(CLOCK)[0], torque(CLOCK), motion(CLOCK + 0.01)[0]
    columns = {"t": CLOCK} | {
        f"{key}_{joint}": array[:, k]
        for key, array in (("q", q), ("tau", tau), ("q_ref", q_ref))
        for k, joint in enumerate(JOINTS)
    }
    csv.write_csv(pa.table(columns), tmp_path / "r.csv")
    parquet.write_table(pa.table(columns), tmp_path / "r.parquet")
    np.savez(tmp_path / "r.npz", t=CLOCK, q=q, tau=tau, q_ref=q_ref, joints=list(JOINTS))
    opened = [open_recording(tmp_path / name, JOINTS) for name in ("r.csv", "r.parquet", "r.npz")]
    for recording in (*opened, clean_recording(CLOCK, q_ref=q_ref)):
        assert recording.has_reference
        assert recording.notes == ()
        assert np.array_equal(raw(recording), q_ref)
    swapped = opened[0].of_joints(JOINTS[::-1])
    assert np.array_equal(raw(swapped), q_ref[:, ::-1])


def test_set_points_may_have_other_names_and_units(tmp_path):
    path, mapping = tmp_path / "r.csv", tmp_path / "map.yaml"
    mapping.write_text('joints: {"*": {q_ref: {column: "goal_{index}", unit: deg, sign: -1}}}')
    path.write_text("t,q_a,q_b,tau_a,tau_b,goal_0,goal_1\n0,1,2,3,4,90,180\n1,1,2,3,4,90,180\n")
    recording = open_recording(path, JOINTS, mapping=read_mapping(mapping))
    assert raw(recording)[0] == pytest.approx([-np.pi / 2, -np.pi])


def test_set_points_are_filtered_as_positions_are():
    """A set-point that equals q gives the states themselves; another one gives those of its own motion."""
    q = motion(CLOCK)[0]
    same = clean_recording(CLOCK, q_ref=q)
    for part in tiles(same, survey(same), FILTERING):
        assert part.reference is not None
        for got, expected in zip(part.reference, (part.q, part.qd, part.qdd), strict=True):
            assert torch.allclose(got, expected, rtol=0, atol=1e-10)
    ahead = clean_recording(CLOCK, q_ref=motion(CLOCK + 0.05)[0])
    plain = clean_recording(CLOCK, q=motion(CLOCK + 0.05)[0])
    expected = torch.cat(
        [part.decimate(torch.stack([part.q, part.qd, part.qdd])) for part in tiles(plain, survey(plain), FILTERING)], -1
    )
    assert np.allclose(references(ahead), expected.numpy(), rtol=0, atol=1e-9)


@pytest.mark.parametrize("rows", [1, 333])
def test_set_points_join_whatever_the_tiles_size(rows):
    recording = clean_recording(CLOCK, qd=motion(CLOCK)[1], q_ref=motion(CLOCK + 0.05)[0])
    assert recording.has_velocity
    one = references(recording, 10**9)
    assert np.allclose(references(recording, rows), one, rtol=0, atol=1e-10 * np.abs(one).max())


def test_states_do_not_change_when_a_set_point_is_recorded():
    """Neither the survey nor the states see the set-point, with and without measured velocity."""
    rng = np.random.default_rng(0)
    q, qd, _ = motion(CLOCK)
    noisy, tau = q + 3e-3 * rng.normal(size=q.shape), torque(CLOCK)
    for velocity in (qd + 1e-3 * rng.normal(size=q.shape), None):
        without = Recording.from_arrays("x", JOINTS, CLOCK, noisy, tau, velocity)
        with_it = Recording.from_arrays("x", JOINTS, CLOCK, noisy, tau, velocity, q_ref=np.sign(q))
        seen, expected = survey(with_it), survey(without)
        assert seen.cutoff_hz == expected.cutoff_hz
        for name in ("q_noise_std", "qd_noise_std", "velocity_rms"):
            assert np.array_equal(getattr(seen, name), getattr(expected, name), equal_nan=True)
        pairs = zip(tiles(with_it, seen, FILTERING), tiles(without, expected, FILTERING), strict=True)
        for got, plain in pairs:
            assert plain.reference is None
            assert all(torch.equal(getattr(got, key), getattr(plain, key)) for key in ("q", "qd", "qdd", "tau", "t"))


def test_full_turns_are_unwrapped_on_their_own():
    """The set-point leads and wraps earlier than the position does."""
    angle = np.stack([3 * CLOCK, np.sin(CLOCK)], axis=1)
    ahead = np.stack([3 * (CLOCK + 0.02), np.sin(CLOCK)], axis=1)

    def wrapped(q):
        return np.column_stack(((q[:, 0] + np.pi) % (2 * np.pi) - np.pi, q[:, 1]))

    recording = clean_recording(CLOCK, q=wrapped(angle), q_ref=wrapped(ahead))
    assert "full turns unwrapped: a" in [*map(str, survey(recording).notes)]
    expected = references(clean_recording(CLOCK, q=angle, q_ref=ahead))
    assert np.allclose(references(recording), expected, rtol=0, atol=1e-9)


def test_rows_without_a_set_point_are_left_out():
    q_ref = motion(CLOCK)[0]
    q_ref[500, 1] = np.nan
    seen = survey(clean_recording(CLOCK, q_ref=q_ref))
    assert seen.incomplete == 1


def test_set_points_of_some_joints_only_are_not_used():
    q_ref = motion(CLOCK)[0]
    q_ref[:, 1] = np.nan
    recording = clean_recording(CLOCK, q_ref=q_ref)
    assert not recording.has_reference
    assert [*map(str, recording.notes)] == ["q_ref is not used: it is there for some joints only"]
    assert all(part.reference is None for part in tiles(recording, survey(recording), FILTERING))


def test_wrong_shape_is_told():
    q = motion(CLOCK)[0]
    with pytest.raises(RecordingError, match=r"x: q_ref has shape \(3000, 1\); expected \(3000, 2\)"):
        Recording.from_arrays("x", JOINTS, CLOCK, q, torque(CLOCK), q_ref=q[:, :1])
