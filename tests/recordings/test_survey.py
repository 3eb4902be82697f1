"""Check what a survey says against recordings whose noise, clock and motion are known."""

import os
from functools import partialmethod
from pathlib import Path

import numpy as np
import pytest
from recordings.motion import clean_recording, motion, torque

from torchrbd.errors import RecordingError
from torchrbd.recordings import Filtering, Recording, choose_cutoff, open_recording, survey, tiles

CLOCK = np.arange(0, 20, 0.004)


def test_clock_motion_and_noise():
    seen = survey(clean_recording(CLOCK, noise=2e-4))
    q, qd, _ = motion(CLOCK)
    assert seen.rate_hz == pytest.approx(250)
    assert seen.clock.dt == 0.004
    assert seen.rows == len(CLOCK)
    assert seen.duration_s == pytest.approx(CLOCK[-1])
    assert seen.q_min == pytest.approx(q.min(axis=0), abs=1e-3)
    assert seen.velocity_rms == pytest.approx(np.sqrt((qd**2).mean(axis=0)), rel=0.05)
    assert seen.velocity_max == pytest.approx(np.abs(qd).max(axis=0), rel=0.05)
    assert seen.tau_rms == pytest.approx(np.sqrt((torque(CLOCK) ** 2).mean(axis=0)), rel=1e-3)
    assert seen.q_noise_std == pytest.approx([2e-4, 2e-4], rel=0.15)
    assert np.isnan(seen.q_resolution).all()
    assert seen.notes == ()


def test_quantisation_step_is_seen():
    step = 2 * np.pi / 2**14
    q = np.round(motion(CLOCK)[0] / step) * step
    seen = survey(clean_recording(CLOCK, q=np.round(q, 7)))
    assert seen.q_resolution == pytest.approx([step, step], rel=1e-3)
    assert np.all(seen.q_noise_std >= 0.99 * step / np.sqrt(12))


def test_quantisation_step_of_a_joint_that_hardly_moves_is_seen():
    step = 2 * np.pi / 2**14
    q = motion(CLOCK)[0]
    q[:, 1] = 0.3 + 2e-3 * np.tanh(CLOCK - 6)
    seen = survey(clean_recording(CLOCK, q=np.round(np.round(q / step) * step, 7)))
    assert seen.q_resolution == pytest.approx([step, step], rel=1e-3)
    assert np.all(seen.q_noise_std >= 0.99 * step / np.sqrt(12))


def test_cutoff_falls_with_noise_and_lies_above_the_motion():
    cutoffs = [survey(clean_recording(CLOCK, noise=noise)).cutoff_hz for noise in (0, 1e-5, 1e-3)]
    assert cutoffs[0] >= cutoffs[1] > cutoffs[2] > 0.8
    assert cutoffs[0] <= 0.2 * 250


@pytest.mark.parametrize("rows", [16384, 97])
def test_a_drive_that_is_off_for_a_while_is_told(rows, monkeypatch):
    off = (CLOCK >= 5.0) & (CLOCK < 9.0)
    recording = clean_recording(CLOCK, tau=np.where(off[:, None] * [True, False], 0.0, torque(CLOCK)))
    monkeypatch.setattr(Recording, "chunks", partialmethod(Recording.chunks, rows))
    (note,) = map(str, survey(recording).notes)
    assert note.startswith("tau_a is exactly 0 from 5.00 to 9.00 s while a moves")


def test_a_joint_at_rest_may_have_a_torque_that_does_not_change():
    rest = np.where((CLOCK >= 5.0) & (CLOCK < 9.0), 5.0, CLOCK)
    assert survey(clean_recording(CLOCK, q=motion(rest)[0], tau=torque(rest))).notes == ()


def test_one_cutoff_for_a_data_set():
    seen = [survey(clean_recording(CLOCK, noise=noise)) for noise in (1e-5, 1e-4, 1e-3)]
    assert choose_cutoff(seen) == seen[1].cutoff_hz
    slow = survey(clean_recording(CLOCK[::25], noise=1e-5))
    assert choose_cutoff([seen[0], seen[0], slow]) <= 0.2 * slow.rate_hz


def test_recordings_at_rest_choose_no_cutoff():
    moving = survey(clean_recording(CLOCK, noise=1e-5))
    noise = 1e-5 * np.random.default_rng(0).standard_normal((len(CLOCK), 2))
    still = survey(clean_recording(CLOCK, q=0.3 + noise))
    assert still.cutoff_hz != moving.cutoff_hz
    assert choose_cutoff([moving, still, still]) == moving.cutoff_hz
    assert choose_cutoff([still, still]) == still.cutoff_hz


def test_duplicates_are_dropped_and_counted():
    t = np.sort(np.concatenate([CLOCK, CLOCK[100:110]]))
    recording = clean_recording(t)
    seen = survey(recording)
    assert seen.duplicates == 10
    assert len(seen.segments) == 1
    assert [*map(str, seen.notes)] == ["10 of 5010 rows dropped: their time repeats the row before"]


def test_regular_clock_with_lost_rows_keeps_its_rate():
    keep = np.random.default_rng(0).random(len(CLOCK)) > 0.03
    assert survey(clean_recording(CLOCK[keep])).clock.dt == 0.004


def test_constant_channels():
    q, tau = motion(CLOCK)[0], torque(CLOCK)
    q[:, 1] = 0.3
    for noise in (0.0, 1e-10):
        tau[:, 0] = 50.0 + noise * np.random.default_rng(0).standard_normal(len(CLOCK))
        seen = survey(clean_recording(CLOCK, q=q, tau=tau))
        assert (seen.constant_q, seen.constant_tau) == (("b",), ("a",))
    with pytest.raises(RecordingError, match="nothing moves"):
        survey(clean_recording(CLOCK, q=0 * q + 0.7))


def test_too_short():
    with pytest.raises(RecordingError, match="clean: only 5 rows with 5 different times; that is too short"):
        survey(clean_recording(CLOCK[:5]))
    with pytest.raises(RecordingError, match="rows dropped: a value is missing"):
        survey(clean_recording(CLOCK[:14], q=np.full((14, 2), np.nan)))


DATA = Path(os.environ.get("TORCHRBD_DATA", "."))
needs_data = pytest.mark.skipif("TORCHRBD_DATA" not in os.environ, reason="TORCHRBD_DATA names no folder of recordings")


@needs_data
@pytest.mark.parametrize(
    ("folder", "joints", "low", "high"),
    [
        ("kuka_kr300/[ABC].csv", [f"A{k}" for k in range(1, 7)], 3, 10),
        ("dfki_double_pendulum/C_20220914_0*.csv", ["shoulder", "elbow"], 5, 14),
        ("dfki_pendulum/*.csv", ["theta"], 3, 8),
    ],
)
def test_real_recordings(folder, joints, low, high):
    recordings = [open_recording(path, joints) for path in sorted(DATA.glob(folder))]
    assert recordings
    surveys = [survey(recording) for recording in recordings]
    cutoff = choose_cutoff(surveys)
    assert low <= cutoff <= high
    for recording, seen in zip(recordings, surveys, strict=True):
        assert isinstance(recording, Recording)
        total = sum(len(part.t_out) for part in tiles(recording, seen, Filtering(cutoff)))
        assert total > seen.duration_s  # more than one output a second
