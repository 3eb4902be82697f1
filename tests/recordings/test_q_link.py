"""Encoders behind the gear, where a recording has them: streamed and filtered next to q, for some joints or all."""

from functools import partialmethod

import numpy as np
import pyarrow as pa
import pytest
import torch
from pyarrow import csv, parquet
from recordings.motion import JOINTS, motion, torque

from torchrbd.recordings import Filtering, Recording, open_recording, read_mapping, survey, tiles

CLOCK = np.arange(0, 12, 0.004)
FILTERING = Filtering(6.0)
Q = motion(CLOCK)[0]
LINK = Q - 0.01 * torque(CLOCK)


def recording(q_link, q=Q, **more):
    return Recording.from_arrays("geared", JOINTS, CLOCK, q, torque(CLOCK), q_link=q_link, **more)


def raw(one):
    chunks = list(one.chunks())
    assert all(chunk.q_link is not None for chunk in chunks)
    return np.concatenate([chunk.q_link for chunk in chunks])


def filtered(one, rows=4096):
    """Return q and q_link of all tiles (2, n, M), decimated."""
    parts = []
    for part in tiles(one, survey(one), FILTERING, rows):
        assert part.q_link is not None
        parts.append(part.decimate(torch.stack((part.q, part.q_link))))
    return torch.cat(parts, dim=-1).numpy()


def test_they_are_read_from_every_format(tmp_path):
    columns = {"t": CLOCK} | {
        f"{key}_{joint}": array[:, k]
        for key, array in (("q", Q), ("tau", torque(CLOCK)), ("q_link", LINK))
        for k, joint in enumerate(JOINTS)
    }
    csv.write_csv(pa.table(columns), tmp_path / "r.csv")
    parquet.write_table(pa.table(columns), tmp_path / "r.parquet")
    np.savez(tmp_path / "r.npz", t=CLOCK, joints=list(JOINTS), q=Q, tau=torque(CLOCK), q_link=LINK)
    for name in ("r.csv", "r.parquet", "r.npz"):
        opened = open_recording(tmp_path / name, JOINTS)
        assert opened.linked.all()
        assert opened.notes == ()
        assert np.array_equal(raw(opened), LINK)
        assert np.array_equal(raw(opened.of_joints(JOINTS[::-1])), LINK[:, ::-1])


def test_other_names_units_and_gears(tmp_path):
    path, mapping = tmp_path / "r.csv", tmp_path / "map.yaml"
    mapping.write_text(
        'joints: {"*": {q: {column: "motor_{index}", unit: deg, gear_ratio: 100}, '
        'q_link: {column: "out_{index}", unit: deg, sign: -1}}}'
    )
    path.write_text("t,motor_0,motor_1,tau_a,tau_b,out_0,out_1\n0,9000,0,3,4,-90,0\n1,9000,0,3,4,-90,0\n")
    chunk = next(iter(open_recording(path, JOINTS, mapping=read_mapping(mapping)).chunks()))
    assert chunk.q_link is not None
    assert chunk.q[0] == pytest.approx([np.pi / 2, 0])
    assert chunk.q_link[0] == pytest.approx([np.pi / 2, 0])


@pytest.mark.parametrize("rows", [4096, 333])
def test_they_are_filtered_as_positions_are(rows):
    """The deflection of filtered positions is the filtered deflection, whatever the tiles and the other channels."""
    deflection = np.column_stack((0.1 * CLOCK - 0.5, np.full(len(CLOCK), 0.2)))  # lines pass a low-pass unchanged
    q, link = filtered(recording(Q - deflection), rows)
    both = recording(Q - deflection, q_ref=Q, temperature=np.full_like(Q, 30.0))
    assert np.allclose(filtered(both, rows), (q, link), rtol=0, atol=1e-12)
    t = np.concatenate([part.t_out.numpy() for part in tiles(both, survey(both), FILTERING, rows)])
    assert np.allclose(q - link, [0.1 * t - 0.5, np.full(len(t), 0.2)], rtol=0, atol=1e-9)
    part = next(tiles(both, survey(both), FILTERING))
    assert part.reference is not None
    torch.testing.assert_close(part.reference[0], part.q)
    assert part.temperature is not None
    torch.testing.assert_close(part.temperature, torch.full_like(part.q, 30.0))


def test_nothing_else_changes():
    with_, without = (next(tiles(r, survey(r), FILTERING)) for r in (recording(LINK), recording(None)))
    assert without.q_link is None
    assert all(torch.equal(getattr(with_, key), getattr(without, key)) for key in ("q", "qd", "qdd", "tau", "t"))
    thin = with_.thinned(2 if with_.stride % 2 == 0 else 1)
    assert thin.q_link is not None
    assert thin.q_link.shape == thin.q.shape


def test_some_joints_only():
    half = LINK.copy()
    half[:, 0] = np.nan
    one = recording(half)
    assert one.linked.tolist() == [False, True]
    assert one.of_joints(JOINTS[::-1]).linked.tolist() == [True, False]
    link = filtered(one)[1]
    assert np.isnan(link[0]).all()
    assert np.array_equal(link[1], filtered(recording(LINK))[1, 1])
    assert np.isnan(survey(one).link_ratio[0])


def test_full_turns_are_unwrapped_on_their_own():
    """The link lags and wraps later than the motor does."""
    angle = np.stack([3 * CLOCK, np.sin(CLOCK)], axis=1)
    behind = angle - [0.03, 0.0]

    def wrapped(q):
        return np.column_stack(((q[:, 0] + np.pi) % (2 * np.pi) - np.pi, q[:, 1]))

    q, link = filtered(recording(wrapped(behind), wrapped(angle)))
    assert np.allclose(q - link, [[0.03], [0.0]], rtol=0, atol=1e-9)


def test_rows_without_one_are_left_out():
    gap = LINK.copy()
    gap[500, 1] = np.nan
    assert survey(recording(gap)).incomplete == 1


def test_a_position_that_does_not_follow_is_told_of():
    """In degrees, the wrong way round, and as it should be; a joint that stands still says nothing."""
    still = Q * [1.0, 0.0]
    for wrong, ratio in ((np.rad2deg(Q), 57.3), (-Q, -1.0), (LINK, None)):
        seen = survey(recording(wrong))
        told = [note for note in map(str, seen.notes) if note.startswith("q_link_a")]
        assert bool(told) == (ratio is not None)
        assert seen.link_follows[0] == (ratio is None)
        if ratio is not None:
            assert seen.link_ratio[0] == pytest.approx(ratio, rel=1e-3)
            assert f"moves {ratio:.3g} times as far as q_a" in told[0]
    seen = survey(recording(still - 1e-5 * torque(CLOCK), still))
    assert seen.link_follows.all()
    assert not any("q_link" in note for note in map(str, seen.notes))


@pytest.mark.parametrize("rows", [16384, 97])
def test_a_copy_of_the_position_is_told_of(rows, monkeypatch):
    monkeypatch.setattr(Recording, "chunks", partialmethod(Recording.chunks, rows))
    some = np.stack((np.full(len(CLOCK), np.nan), Q[:, 1]), 1)
    (note,) = survey(recording(some)).notes
    assert str(note) == "q_link_b is q_b to the last digit and is not used"
    assert not survey(recording(some)).link_differs.any()
    some[-1, 1] += 1e-9
    assert survey(recording(some)).notes == ()
    assert survey(recording(some)).link_differs.tolist() == [False, True]
