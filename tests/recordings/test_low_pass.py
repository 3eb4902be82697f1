"""Torques that were low-passed before they were recorded: the filter, where they end, and both sides of an equation."""

import numpy as np
import pytest
import torch
from recordings.motion import clean_recording, motion, torque
from scipy import signal

from torchrbd.recordings import Filtering, LowPass, survey, tiles

CLOCK = np.arange(0, 20, 0.004)


def filtered(x: np.ndarray, half_hz: float, order: int) -> np.ndarray:
    """Return x (N, n) on the clock as people filter it, by scipy."""
    sos = signal.butter(order, half_hz * 2 * 0.004, output="sos")
    return signal.sosfiltfilt(sos, x, axis=0)


@pytest.mark.parametrize(("half_hz", "order"), [(1.7, 4), (3.0, 2), (5.0, 1), (8.0, 6)])
def test_kernel_is_a_butterworth_filter_run_twice(half_hz: float, order: int) -> None:
    pulse = np.zeros((len(CLOCK), 1))
    pulse[len(CLOCK) // 2] = 1.0
    kernel = LowPass(half_hz, order).kernel(0.004)
    reach = len(kernel) // 2
    expected = filtered(pulse, half_hz, order)[len(CLOCK) // 2 - reach : len(CLOCK) // 2 + reach + 1, 0]
    assert kernel.sum() == pytest.approx(1.0)
    np.testing.assert_array_equal(kernel, kernel[::-1])
    # A digital filter has no frequencies above half the clock's; at order 1 that is 4 % of the middle weight.
    assert np.abs(kernel - expected).max() < (0.05 if order == 1 else 0.01) * expected.max()


def test_torque_and_features_pass_the_same_filters() -> None:
    """What is recorded of a feature, as a torque, equals the feature."""
    passed = LowPass(1.7, 4)
    q, *_ = motion(CLOCK)
    steps = np.sign(np.sin(2 * np.pi * 0.4 * CLOCK))[:, None] * np.ones_like(q)
    tau = filtered(steps, passed.half_hz, passed.order)
    recording = clean_recording(CLOCK, tau=tau)
    for part in tiles(recording, survey(recording), Filtering(6.0, low_pass=passed), 700):
        true = torch.sign(torch.sin(2 * np.pi * 0.4 * part.t)).expand_as(part.q)
        got, expected = part.decimate_torque(part.tau), part.decimate(true)
        inside = (part.t_out > 3.0) & (part.t_out < 17.0)
        assert not bool(((got - expected).abs() > 0.02)[:, inside].any())
        torch.testing.assert_close(part.decimate_torque(part.as_recorded(true)), expected, rtol=0, atol=1e-10)


def test_thinned_states_have_the_same_outputs() -> None:
    recording = clean_recording(CLOCK)
    (part,) = tiles(recording, survey(recording), Filtering(2.0, low_pass=LowPass(1.7, 4)), 100_000)
    coarse = part.thinned(2)
    for whole, few in ((part.decimate, coarse.decimate), (part.decimate_torque, coarse.decimate_torque)):
        torch.testing.assert_close(few(coarse.q), whole(part.q), rtol=0, atol=1e-4)


def test_without_a_filter_both_sides_are_as_before() -> None:
    recording = clean_recording(CLOCK)
    (part,) = tiles(recording, survey(recording), Filtering(6.0), 100_000)
    torch.testing.assert_close(part.decimate_torque(part.q), part.decimate(part.q), rtol=0, atol=0)
    assert part.as_recorded(part.q) is part.q


def test_where_torques_end() -> None:
    rng = np.random.default_rng(0)
    steps = np.sign(np.sin(2 * np.pi * 0.4 * CLOCK))[:, None] * np.ones((1, 2)) + torque(CLOCK)
    noisy = steps + 1e-3 * rng.standard_normal(steps.shape)
    ends = {
        "filtered": survey(clean_recording(CLOCK, tau=filtered(noisy, 1.7, 4))).torque_ends_hz,
        "noisy": survey(clean_recording(CLOCK, tau=noisy)).torque_ends_hz,
        "12 bits": survey(clean_recording(CLOCK, tau=np.round(steps / 2e-3) * 2e-3)).torque_ends_hz,
        "one joint is not": survey(
            clean_recording(CLOCK, tau=np.column_stack((filtered(noisy, 1.7, 4)[:, 0], noisy[:, 1])))
        ).torque_ends_hz,
    }
    assert 2.0 < ends.pop("filtered") < 20.0
    assert np.isnan(list(ends.values())).all()
