"""Temperatures of joints, where a recording has them: streamed, held between readings and filtered next to q."""

import numpy as np
import pyarrow as pa
import pytest
import torch
from pyarrow import csv, parquet
from recordings.motion import JOINTS, motion, torque

from torchrbd.recordings import Filtering, Recording, open_recording, read_mapping, survey, tiles

CLOCK = np.arange(0, 12, 0.004)
FILTERING = Filtering(6.0)
WARMING = np.stack([20.0 + 2.0 * CLOCK, 35.0 - CLOCK], axis=1)


def recording(temperature, t=CLOCK):
    return Recording.from_arrays("warm", JOINTS, t, motion(t)[0], torque(t), temperature=temperature)


def filtered(recording, rows=4096):
    """Return times and temperatures of all tiles, decimated."""
    t, parts = [], []
    for part in tiles(recording, survey(recording), FILTERING, rows):
        assert part.temperature is not None
        t.append(part.t_out)
        parts.append(part.decimate(part.temperature))
    return torch.cat(t).numpy(), torch.cat(parts, dim=-1).numpy()


def test_temperatures_are_read_from_every_format(tmp_path):
    columns = {"t": CLOCK} | {
        f"{key}_{joint}": array[:, k]
        for key, array in (("q", motion(CLOCK)[0]), ("tau", torque(CLOCK)), ("temperature", WARMING))
        for k, joint in enumerate(JOINTS)
    }
    csv.write_csv(pa.table(columns), tmp_path / "r.csv")
    parquet.write_table(pa.table(columns), tmp_path / "r.parquet")
    arrays = {"q": motion(CLOCK)[0], "tau": torque(CLOCK), "temperature": WARMING}
    np.savez(tmp_path / "r.npz", t=CLOCK, joints=list(JOINTS), **arrays)
    for name in ("r.csv", "r.parquet", "r.npz"):
        opened = open_recording(tmp_path / name, JOINTS)
        assert opened.thermal.all()
        assert opened.notes == ()
        assert np.array_equal(np.concatenate([c.temperature for c in opened.chunks()]), WARMING)
        swapped = np.concatenate([c.temperature for c in opened.of_joints(JOINTS[::-1]).chunks()])
        assert np.array_equal(swapped, WARMING[:, ::-1])


def test_temperatures_are_filtered_as_positions_are():
    """What changes linearly passes unchanged, whatever the tiles; positions and torques are as without."""
    for rows in (4096, 700):
        t, found = filtered(recording(WARMING), rows)
        np.testing.assert_allclose(found, np.stack([20.0 + 2.0 * t, 35.0 - t]), rtol=1e-9)
    with_, without = (next(tiles(r, survey(r), FILTERING)) for r in (recording(WARMING), recording(None)))
    assert without.temperature is None
    assert torch.equal(with_.q, without.q)
    assert torch.equal(with_.qdd, without.qdd)
    assert torch.equal(with_.tau, without.tau)


def test_some_joints_only():
    half = WARMING.copy()
    half[:, 0] = np.nan
    one = recording(half)
    assert one.thermal.tolist() == [False, True]
    assert one.of_joints(JOINTS[::-1]).thermal.tolist() == [True, False]
    t, found = filtered(one)
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1], 35.0 - t, rtol=1e-9)
    seen = survey(one)
    assert np.isnan(seen.temperature_min[0])
    assert seen.temperature_min[1] == pytest.approx(35.0 - CLOCK[-1])
    assert seen.temperature_max[1] == pytest.approx(35.0)


def test_slow_readings_are_held_and_cost_no_rows():
    """One reading a second, the first after half a second; the rows between have none."""
    slow = np.full_like(WARMING, np.nan)
    slow[125::250] = WARMING[125::250]
    seen = survey(recording(slow))
    assert seen.rows == len(CLOCK)
    assert seen.incomplete == 0
    t, found = filtered(recording(slow))
    assert np.abs(found[0] - (20.0 + 2.0 * (t - 0.5))).max() < 1.2  # half a reading's step, and the filter's ringing
    for a, b in zip(filtered(recording(slow), 700), filtered(recording(slow)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)


def test_set_points_beside_temperatures():
    q = motion(CLOCK)[0]
    both = Recording.from_arrays("both", JOINTS, CLOCK, q, torque(CLOCK), q_ref=q, temperature=WARMING)
    part = next(tiles(both, survey(both), FILTERING))
    assert part.reference is not None
    torch.testing.assert_close(part.reference[0], part.q)
    torch.testing.assert_close(part.temperature[1], 35.0 - part.t)


def test_other_names_and_units(tmp_path):
    path, mapping = tmp_path / "r.csv", tmp_path / "map.yaml"
    mapping.write_text('joints: {"*": {temperature: {column: "motor_{index}", unit: degC, offset: -273.15}}}')
    path.write_text("t,q_a,q_b,tau_a,tau_b,motor_0,motor_1\n0,1,2,3,4,300,310\n1,1,2,3,4,300,310\n")
    opened = open_recording(path, JOINTS, mapping=read_mapping(mapping))
    assert next(iter(opened.chunks())).temperature[0] == pytest.approx([26.85, 36.85])
