"""Check that slow positions are told by the steps of their encoder, against the motion that was rounded."""

import numpy as np
import pytest

from torchrbd.recordings import Recording, uniform_blocks
from torchrbd.recordings.blocks import Block
from torchrbd.recordings.clock import Clock
from torchrbd.recordings.encoder_steps import between_steps, interpolated

STEP, RATE = 2e-4, 125.0
T = np.arange(3000) / RATE


def rounded(q: np.ndarray) -> np.ndarray:
    return STEP * np.round(q / STEP)


def error(q: np.ndarray) -> tuple[float, float]:
    """Return the RMS error of a reading and of what its steps tell, without both ends."""
    inside = slice(100, -100)
    read, told = rounded(q), interpolated(T, rounded(q), STEP)
    return float(np.std((read - q)[inside])), float(np.std((told - q)[inside]))


@pytest.mark.parametrize("speed", [5e-4, 1e-3, 2.5e-3])
def test_positions_of_a_joint_that_creeps_are_told_many_times_better(speed: float) -> None:
    read, told = error(0.3 + speed * T + 1e-5 * np.sin(2 * np.pi * 0.2 * T))
    assert told < 0.25 * read


def test_motion_that_steps_with_nearly_every_row_is_left_as_it_is() -> None:
    q = rounded(0.4 * np.sin(2 * np.pi * 0.7 * T))
    fast = np.abs(np.gradient(q, T)) > 4 * STEP * RATE
    np.testing.assert_array_equal(interpolated(T, q, STEP)[fast], q[fast])


def test_joint_at_rest_keeps_its_reading_and_one_that_turns_stays_within_a_step() -> None:
    np.testing.assert_array_equal(interpolated(T, np.full(3000, 0.7), STEP), np.full(3000, 0.7))
    q = 0.3 + 0.01 * np.cos(2 * np.pi * 0.05 * T)
    told = interpolated(T, rounded(q), STEP)
    assert np.abs(told - rounded(q)).max() <= 0.5 * STEP + 1e-12
    assert error(q)[1] < error(q)[0]


@pytest.mark.parametrize("back", [1, -1])
def test_joint_that_rests_rests_in_the_middle_of_its_reading_and_starts_at_once(back: int) -> None:
    """It comes at half a step a row, rests for 100 rows, and goes on, or back, as fast."""
    steps = np.concatenate((np.arange(40), np.full(100, 40), 40 + back * np.arange(1, 41)))
    rows = np.repeat(steps, np.where(steps == 40, 1, 2))
    q = 0.3 + STEP * rows
    told = interpolated(T[: len(q)], q, STEP)
    rest = np.flatnonzero(rows == 40)
    np.testing.assert_allclose(told[rest[2:-2]], q[rest[2:-2]], atol=1e-12)
    assert (told[rest[:1]] < q[rest[0]]).all()


def test_joint_that_turns_smoothly_within_a_reading_is_followed() -> None:
    q = 0.3 + STEP * (0.3 + 60.0 * (T - 12.0) ** 2)
    near = np.abs(T - 12.0) < 0.3
    told = interpolated(T, rounded(q), STEP)
    assert np.std((told - q)[near]) < 0.4 * np.std((rounded(q) - q)[near])


def test_frequencies_of_the_motion_are_freed_of_the_sawtooth() -> None:
    """Below the band of the rows a creeping joint's readings hold what their steps do not."""
    q = 0.3 + 5e-4 * T
    power = [
        np.abs(np.fft.rfft((x - q)[500:2500] * np.hanning(2000)))[5:80].sum()
        for x in (rounded(q), interpolated(T, rounded(q), STEP))
    ]
    assert power[1] < 0.1 * power[0]


@pytest.mark.parametrize("rows", [1, 7, 130, 5000])
def test_blocks_may_be_cut_anywhere(rows: int) -> None:
    rng = np.random.default_rng(3)
    q = np.stack((rounded(np.cumsum(1e-5 * rng.normal(size=3000))), 0.5 * np.sin(T)))
    whole = Block(0, T, np.concatenate((q, rng.normal(size=(2, 3000)))))
    blocks = (whole.rows(k, min(k + rows, 3000)) for k in range(0, 3000, rows))
    found = list(between_steps(blocks, np.array([STEP, np.nan])))
    np.testing.assert_array_equal(np.concatenate([b.t for b in found]), T)
    x = np.concatenate([b.x for b in found], axis=1)
    np.testing.assert_allclose(x[0], interpolated(T, q[0], STEP), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(x[1:], whole.x[1:])


def test_segments_are_told_apart() -> None:
    q = rounded(1e-3 * T)[None]
    early, late = Block(0, T, np.concatenate((q, q))), Block(1, T + 100.0, np.concatenate((1.0 + q, q)))
    found = list(between_steps(iter((early, late)), np.array([STEP])))
    x = [np.concatenate([b.x[0] for b in found if b.segment == k]) for k in (0, 1)]
    np.testing.assert_allclose(x[1], 1.0 + x[0], atol=1e-12)


def test_recording_is_read_between_its_steps() -> None:
    """A joint with steps is interpolated on the way to its states; one without is not."""
    q = np.stack((0.3 * np.sin(0.5 * T) + 2e-3 * T, 0.2 * np.cos(1.3 * T)), 1)
    q[:, 0] = rounded(q[:, 0])
    recording = Recording.from_arrays("creeps", ("a", "b"), T, q, np.ones((3000, 2)))
    clock = Clock.of(recording)
    assert clock.step[0] == pytest.approx(STEP)
    assert np.isnan(clock.step[1])
    x = np.concatenate([block.x for block in uniform_blocks(recording, clock)], axis=1)
    np.testing.assert_allclose(x[0], interpolated(T, q[:, 0], STEP), atol=1e-9)
    np.testing.assert_allclose(x[1], q[:, 1], atol=1e-9)
