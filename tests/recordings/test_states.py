"""Check the chain from rows to tiles."""

import dataclasses

import numpy as np
import pytest
import torch
from recordings.motion import clean_recording, motion, torque

from torchrbd.errors import RecordingError
from torchrbd.recordings import Filtering, Recording, skipped_segments, survey, tiles

FILTERING = Filtering(6.0)
CLOCK = np.arange(0, 12, 0.004)


def outputs(recording, rows=4096, filtering=FILTERING):
    """Return t_out (M,), and decimated q, qd, qdd, tau stacked (4 n, M)."""
    parts = list(tiles(recording, survey(recording), filtering, rows))
    stacked = [part.decimate(torch.cat([part.q, part.qd, part.qdd, part.tau])) for part in parts]
    return torch.cat([part.t_out for part in parts]).numpy(), torch.cat(stacked, dim=-1).numpy()


def truth(t):
    """Return the motion's own values (8, M)."""
    return np.concatenate([*motion(t), torque(t)], axis=1).T


def test_states_and_torque_match_the_motion():
    t, got = outputs(clean_recording(CLOCK))
    expected = truth(t)
    assert np.abs(got - expected).max() < 2e-3 * np.abs(expected).max()
    for part in tiles(clean_recording(CLOCK), survey(clean_recording(CLOCK)), FILTERING):
        q, qd, qdd = motion(part.t.numpy())
        assert np.abs(part.q.numpy().T - q).max() < 1e-4
        assert np.abs(part.qd.numpy().T - qd).max() < 1e-3
        assert np.abs(part.qdd.numpy().T - qdd).max() < 1e-2
        assert np.allclose(part.tau.numpy().T, torque(part.t.numpy()), atol=1e-9)


@pytest.mark.parametrize("delay", [0.004, -0.008, 0.0133])
@pytest.mark.parametrize("rows", [1, 333, 100000])
def test_torques_that_are_written_late_are_those_of_the_motion(delay, rows):
    written = dataclasses.replace(clean_recording(CLOCK, tau=torque(CLOCK - delay)), torque_delay_s=delay)
    t, got = outputs(written, rows)
    t_on_time, got_on_time = outputs(clean_recording(CLOCK), rows)
    error, on_time = np.abs(got - truth(t)).max(1), np.abs(got_on_time - truth(t_on_time)).max(1)
    assert np.allclose(error, on_time, rtol=1e-3)
    t, unaware = outputs(dataclasses.replace(written, torque_delay_s=0.0), rows)
    assert np.abs(unaware - truth(t))[6:].max() > 2 * on_time[6:].max()
    # An end that lacks the torque is left out.
    last = max(float(part.t[-1]) for part in tiles(written, survey(written), FILTERING, rows))
    assert last <= CLOCK[-1] - max(delay, 0.0)


def test_linear_relation_survives_the_chain():
    """tau = qdd + 3 q holds for the outputs far better than either side matches the motion."""
    _, got = outputs(clean_recording(CLOCK))
    assert np.abs(got[6:] - got[4:6] - 3 * got[:2]).max() < 2e-3


@pytest.mark.parametrize("rows", [1, 100, 333, 100000])
def test_tiles_join_whatever_their_size(rows):
    recording = clean_recording(CLOCK, noise=1e-4)
    t, got = outputs(recording, rows)
    t_one, one = outputs(recording, 10**9)
    assert np.allclose(t, t_one, atol=1e-9)
    assert np.allclose(got, one, rtol=0, atol=1e-10 * np.abs(one).max())
    assert np.allclose(np.diff(t), FILTERING.stride(0.004) * 0.004)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 100, 333])
def test_a_tile_knows_where_joints_have_turned_before(rows):
    recording = clean_recording(CLOCK)
    (whole,) = tiles(recording, survey(recording), FILTERING, 10**9)
    assert whole.turned == ()
    first, *parts = tiles(recording, survey(recording), FILTERING, rows)
    assert first.turned == ()
    for part in parts:
        k = int(torch.searchsorted(whole.t, part.t[0] - 1e-9))
        for q, before in zip(whole.q, part.turned, strict=True):
            turns = [q[i] for i in range(1, k - 1) if (q[i] - q[i - 1]) * (q[i + 1] - q[i]) < 0]
            np.testing.assert_allclose(before, [q[0], *turns, q[k - 1]] if k > 1 else [q[0]], atol=1e-10)


@pytest.mark.parametrize("rows", [7, 50, 1000])
def test_result_does_not_depend_on_how_rows_are_chunked(rows, monkeypatch):
    rng = np.random.default_rng(0)
    recording = clean_recording(np.cumsum(rng.uniform(0.001, 0.006, size=3000)))
    _, expected = outputs(recording)
    chunks = Recording.chunks
    monkeypatch.setattr(Recording, "chunks", lambda self: chunks(self, rows))
    _, got = outputs(recording)
    assert np.allclose(got, expected, rtol=0, atol=1e-9)


def test_irregular_clock():
    rng = np.random.default_rng(1)
    rows = np.cumsum(rng.uniform(0.0025, 0.0055, size=3000))
    t, got = outputs(clean_recording(rows - rows[0]))
    expected = truth(t)
    assert np.abs(got - expected).max() < 2e-3 * np.abs(expected).max()


def test_decimate_is_the_strided_convolution_and_differentiable():
    recording = clean_recording(CLOCK)
    part = next(tiles(recording, survey(recording), FILTERING, 300))
    x = torch.randn(3, 2, len(part.t), dtype=torch.float64)
    kernel, stride = FILTERING.feature_kernel(part.dt), FILTERING.stride(part.dt)
    expected = torch.nn.functional.conv1d(x.reshape(6, 1, -1), kernel[None, None], stride=stride)
    assert torch.allclose(part.decimate(x), expected.reshape(3, 2, -1), atol=1e-14)
    assert part.decimate(x).shape[-1] == len(part.t_out)
    assert part.decimate(x.float()).dtype == torch.float32
    x = torch.randn(len(part.t), dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(part.decimate, x)


def test_nothing_is_interpolated_over_a_gap():
    t = np.concatenate([np.arange(0, 5, 0.004), np.arange(5.7, 11, 0.004)])
    recording = clean_recording(t)
    seen = survey(recording)
    assert np.allclose(seen.segments, [(0, 4.996), (5.7, 10.996)])
    assert "2 separate pieces" in " ".join(map(str, seen.notes))
    reach = FILTERING.reach(0.004) * 0.004
    times, got = outputs(recording)
    assert not np.any((times > 4.996 - reach + 1e-9) & (times < 5.7 + reach - 1e-9))
    assert np.abs(got - truth(times)).max() < 2e-3 * np.abs(truth(times)).max()
    assert {part.segment for part in tiles(recording, seen, FILTERING)} == {0, 1}


def test_short_segments_are_left_out_and_reported():
    t = np.concatenate([np.arange(0, 0.5, 0.004), np.arange(1, 9, 0.004)])
    recording = clean_recording(t)
    seen = survey(recording)
    assert np.allclose(skipped_segments(seen, FILTERING), [(0, 0.496)])
    assert {part.segment for part in tiles(recording, seen, FILTERING)} == {1}
    with pytest.raises(RecordingError, match=r"lasts 8 s, but the filters at 0.2 Hz need 31.9 s"):
        list(tiles(recording, seen, Filtering(0.2)))


def test_missing_rows_and_values_do_not_bias():
    q, tau = motion(CLOCK)[0], torque(CLOCK)
    q[100, 0] = tau[777, 1] = np.nan
    tau[1000:1100] = np.nan
    recording = clean_recording(CLOCK, q=q, tau=tau)
    seen = survey(recording)
    assert seen.incomplete == 102
    assert len(seen.segments) == 2
    times, got = outputs(recording)
    assert np.abs(got - truth(times)).max() < 2e-3 * np.abs(truth(times)).max()


def test_unmeasured_torque_stays_unknown():
    tau = torque(CLOCK)
    tau[:, 1] = np.nan
    recording = clean_recording(CLOCK, tau=tau)
    assert recording.measured.tolist() == [True, False]
    assert [*map(str, recording.notes)] == ["no torque for b"]
    _, got = outputs(recording)
    assert np.isfinite(got[:7]).all()
    assert np.isnan(got[7]).all()


def test_full_turns_are_unwrapped():
    q = np.stack([3 * CLOCK, np.sin(CLOCK)], axis=1)
    wrapped = q.copy()
    wrapped[:, 0] = (q[:, 0] + np.pi) % (2 * np.pi) - np.pi
    recording = clean_recording(CLOCK, q=wrapped)
    assert "full turns unwrapped: a" in [*map(str, survey(recording).notes)]
    _, got = outputs(recording)
    _, expected = outputs(clean_recording(CLOCK, q=q))
    assert np.allclose(got, expected, atol=1e-9)


def test_measured_velocity_is_used_only_where_it_is_better():
    rng = np.random.default_rng(0)
    q, qd, _ = motion(CLOCK)
    noisy = q + 3e-3 * rng.normal(size=q.shape)
    good = qd + 1e-3 * rng.normal(size=q.shape)
    late = motion(CLOCK - 0.02)[1]
    bad = qd + 1.0 * rng.normal(size=q.shape)
    seen = survey(clean_recording(CLOCK, q=noisy, qd=np.stack([good[:, 0], bad[:, 1]], axis=1)))
    assert np.isnan(seen.qd_noise_std).tolist() == [False, True]
    assert seen.qd_noise_std[0] == pytest.approx(1e-3, rel=0.3)
    assert np.isnan(survey(clean_recording(CLOCK, q=noisy, qd=late)).qd_noise_std).all()
    _, got = outputs(clean_recording(CLOCK, q=noisy, qd=good))
    t, without = outputs(clean_recording(CLOCK, q=noisy))
    error, error_without = (np.abs(x - truth(t))[2:6].max() for x in (got, without))
    assert error < 0.2 * error_without
