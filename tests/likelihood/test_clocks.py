"""Clocks of torque and motion: of recordings that are fitted, and of those that are held out."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from likelihood.arms import reading_of, recorded, wrong_robot
from likelihood.fits import OPTIONS, URDF, with_friction

import torchrbd
from torchrbd.dataset.reading import Reading
from torchrbd.likelihood.clocks import Clocks, in_time, of_one_machine


def test_a_held_out_recording_has_the_mean_of_the_others() -> None:
    found = {"a": (0.002, 0.0001), "b": (0.003, 0.0002)}
    every = of_one_machine(found, ["a", "b", "c"])
    assert {name: every[name] for name in found} == found
    weight = np.array([1e8, 0.25e8])
    mean = float(weight @ [0.002, 0.003] / weight.sum())
    scatter = float(weight @ (np.array([0.002, 0.003]) - mean) ** 2 / weight.sum())
    assert every["c"] == pytest.approx((mean, (1.0 / weight.sum() + scatter) ** 0.5))
    # Clocks that scatter tell nothing of another one.
    late, std = of_one_machine({"a": (0.01, 0.001), "b": (-0.01, 0.001)}, ["a", "b", "c"])["c"]
    assert abs(late) < 3.0 * std


def test_clocks_that_are_far_apart_are_brought_together() -> None:
    one = recorded(URDF, 2, with_friction(), delay_s=0.03, **OPTIONS)
    reading, columns = reading_of(wrong_robot(URDF, 1), [one])
    found = in_time(reading, columns, lambda _, t: torch.zeros(len(t), dtype=torch.bool), frozenset())
    late, std = found.delay_s["simulated"]
    assert abs(late - 0.03) < 4.0 * std
    assert abs(float(found.fit.delay_s[0])) < 0.01
    assert found.against > 30.0


def read_in_time(off: dict[str, float], encoder_noise: float = 1e-5) -> tuple[Reading, Clocks]:
    one = recorded(URDF, 2, with_friction(), **{**OPTIONS, **off, "encoder_noise": encoder_noise})
    reading, columns = reading_of(wrong_robot(URDF, 1), [one])
    return reading, in_time(reading, columns, lambda _, t: torch.zeros(len(t), dtype=torch.bool), frozenset())


@pytest.mark.parametrize("command", [True, False], ids=["a command", "early"])
@pytest.mark.parametrize("encoder_noise", [0.0, 1e-4])
def test_a_command_is_told_from_torque_that_is_early(command: bool, encoder_noise: float) -> None:
    reading, found = read_in_time({"lag_s": 0.04} if command else {"delay_s": -0.04}, encoder_noise)
    assert found.lags is command
    assert found.lag_odds > 5.0 if command else found.lag_odds < -5.0
    assert found.delay_s["simulated"][0] == pytest.approx(-0.04, rel=0.05)
    assert found.read_with(reading, {"simulated": -0.04}).lag_s == ({"simulated": 0.04} if command else {})


@pytest.mark.parametrize("off", [{"lag_s": 0.02}, {"delay_s": -0.02}, {"delay_s": 0.02}])
def test_two_samples_do_not_tell_a_command(off: dict[str, float]) -> None:
    _, found = read_in_time(off)
    assert abs(found.lag_odds) < 3.0


def test_a_held_out_recording_is_judged_with_the_clock_of_its_machine() -> None:
    """Both recordings are late by as much: torques that are held out are predicted down to their noise."""
    fitted, held = (
        recorded(URDF, seed, with_friction(), name=f"{seed}.csv", delay_s=0.02, **OPTIONS) for seed in (2, 3)
    )
    found = torchrbd.identify(wrong_robot(URDF, 1), fitted, holdout=[held])
    assert all(x < 2e-3 for x in found.fits["extended"].nmse.values())
