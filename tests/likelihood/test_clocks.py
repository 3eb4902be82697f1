"""Clocks of torque and motion: of recordings that are fitted, and of those that are held out."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from likelihood.arms import reading_of, recorded, wrong_robot
from likelihood.fits import OPTIONS, URDF, with_friction

import torchrbd
from torchrbd.likelihood.clocks import in_time, of_one_machine


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


def test_a_held_out_recording_is_judged_with_the_clock_of_its_machine() -> None:
    """Both recordings are late by as much: torques that are held out are predicted down to their noise."""
    fitted, held = (
        recorded(URDF, seed, with_friction(), name=f"{seed}.csv", delay_s=0.02, **OPTIONS) for seed in (2, 3)
    )
    found = torchrbd.identify(wrong_robot(URDF, 1), fitted, holdout=[held])
    assert all(x < 2e-3 for x in found.fits["extended"].nmse.values())
