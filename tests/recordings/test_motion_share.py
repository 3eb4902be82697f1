"""Check which part of the positions' power is taken for motion."""

from __future__ import annotations

import tracemalloc

import numpy as np

from torchrbd.recordings import Recording, survey
from torchrbd.recordings.blocks import Block
from torchrbd.recordings.spectrum import LOWEST_HZ, Spectrum


def spectrum(q: np.ndarray, rate_hz: float) -> Spectrum:
    """Return the spectrum of positions (n, N) in one piece."""
    found = Spectrum(1.0 / rate_hz, len(q), False)
    t = np.arange(q.shape[1]) / rate_hz
    found.add(Block(0, t, np.concatenate((q, 0.0 * q))))
    found.close()
    return found


def moving(rate_hz: float, noise: float, duration_s: float = 12.0) -> np.ndarray:
    t = np.arange(0.0, duration_s, 1.0 / rate_hz)
    rng = np.random.default_rng(0)
    q = np.stack([np.sin(2 * np.pi * 0.7 * t) + 0.1 * np.sin(2 * np.pi * 3.1 * t), 0.3 * np.cos(2 * np.pi * 1.3 * t)])
    return q + noise * rng.normal(size=q.shape)


def test_share_is_one_minus_noise_over_power_that_is_averaged_over_a_third_of_an_octave() -> None:
    one = spectrum(moving(200.0, 1e-3), 200.0)
    f, expected = one.frequency, np.empty(one.acceleration.shape)
    for k in range(len(f)):
        near = [i for i in range(len(f)) if f[k] * 2 ** (-1 / 6) <= f[i] <= f[k] * 2 ** (1 / 6)]
        noise = 1.2 * one.q_noise_density(below_hz=56.25) * one.difference_gain[k] ** 2
        expected[:, k] = 1.0 - noise / one.acceleration[:, near].mean(1)
    expected = np.clip(expected, 0.0, 1.0)
    expected[:, f < LOWEST_HZ] = 1.0
    np.testing.assert_allclose(one.motion_share(), np.minimum.accumulate(expected, 1), atol=1e-9)


def test_motion_is_kept_and_noise_is_not() -> None:
    one = spectrum(moving(200.0, 1e-3), 200.0)
    share, f = one.motion_share(), one.frequency
    assert (share[0, f < 3.0] > 0.95).all()
    assert (share[1, f < 1.3] > 0.99).all()
    assert (share[:, f > 20.0] < 0.1).all()
    assert (np.diff(share, axis=1) <= 0).all()


def test_clean_positions_are_motion_where_there_is_any() -> None:
    one = spectrum(moving(200.0, 0.0), 200.0)
    assert (one.motion_share()[:, one.frequency < 10.0] > 0.999).all()


def test_joint_at_rest_has_no_motion_to_speak_of() -> None:
    q = moving(200.0, 1e-3)
    q[1] = 1e-3 * np.random.default_rng(1).normal(size=q.shape[1])
    share = spectrum(q, 200.0).motion_share()
    assert share[1].mean() < 0.15
    q[1] = 0.3
    assert np.isfinite(spectrum(q, 200.0).motion_share()).all()


def test_fast_clock_takes_little_memory() -> None:
    one = spectrum(moving(10_000.0, 1e-5, 4.0), 10_000.0)
    assert len(one.frequency) == 16_385
    tracemalloc.start()
    one.motion_share()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6


def test_noise_of_a_slow_encoder_on_a_fast_clock_is_not_taken_for_motion() -> None:
    """Steps of 0.2 mrad at 0.05 rad/s come each 4 ms: the Nyquist frequency of 2 kHz tells little of their noise."""
    rate_hz = 2000.0
    t = np.arange(0.0, 20.0, 1.0 / rate_hz)
    q = 0.05 * np.stack([np.sin(t), np.sin(0.7 * t + 1.0)])
    one = spectrum(np.round(q / 2e-4) * 2e-4, rate_hz)
    inside = (one.frequency > 4.0) & (one.frequency < 12.0)
    assert one.motion_share()[:, inside].max() < 0.5


def test_noise_of_a_fast_irregular_clock_is_not_told_from_the_motion() -> None:
    q, t = moving(1000.0, 1e-6), np.arange(0.0, 12.0, 1e-3)
    phases = np.random.default_rng(2).uniform(0.0, 2 * np.pi, 32)
    q += sum(2e-3 * np.sin(2 * np.pi * f * t + p) for f, p in zip(np.arange(4.0, 12.0, 0.25), phases, strict=True))
    one = spectrum(q, 1000.0)
    inside = (one.frequency > 3.0) & (one.frequency < 10.0)
    assert (one.motion_share(regular=False)[:, inside] > 0.99).all()


def test_noise_is_at_least_what_rounding_makes() -> None:
    """What interpolation between steps has taken from high frequencies may remain among the motion."""
    one, step = spectrum(moving(200.0, 1e-5), 200.0), np.array([3e-3, np.nan])
    share, f = one.motion_share(step=step), one.frequency
    noise = 1.2 * 3e-3**2 / 6.0 / 200.0 * one.difference_gain**2
    expected = np.clip(1.0 - noise / np.maximum(one.smooth_acceleration[0], 1e-300), 0.0, 1.0)
    expected[f < LOWEST_HZ] = 1.0
    np.testing.assert_allclose(share[0], np.minimum.accumulate(expected), atol=1e-9)
    assert share[0, f > 5.0].max() < 0.5 < one.motion_share()[0, f > 5.0].max()
    np.testing.assert_array_equal(share[1], one.motion_share()[1])


def test_survey_counts_on_the_rounding_it_sees() -> None:
    """A joint that creeps is told between its steps, so that hardly any noise is left where it is measured."""
    rate_hz, step = 500.0, 2e-4
    t = np.arange(0.0, 60.0, 1.0 / rate_hz)
    q = 0.02 * np.stack([np.sin(0.3 * t), np.sin(0.2 * t + 1.0)], 1)
    seen = survey(Recording.from_arrays("slow", ("a", "b"), t, step * np.round(q / step), np.cos(t)[:, None] + 0.0 * q))
    inside = (seen.share_hz > 4.0) & (seen.share_hz < 12.0)
    assert seen.motion_share[:, inside].max() == 0.0
