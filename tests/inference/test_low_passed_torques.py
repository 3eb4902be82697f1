"""Recordings whose torques, and positions, were low-passed before: recognised, and identified as if they were not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import real_sets
import simulated
import torch
from scipy import signal

import torchrbd
from torchrbd.inference.data.torque_filter import find_low_pass
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.preparation import read
from torchrbd.recordings import Recording

URDF = (Path(torchrbd.__file__).parent / "demo" / "arm.urdf").read_text(encoding="utf-8")
COULOMB = np.array([6.0, 9.0, 5.0, 2.0, 1.5, 1.0])
RATE_HZ = 200.0


def friction(motion) -> np.ndarray:
    return COULOMB * np.sign(motion.qd) + 0.5 * COULOMB * motion.qd


def recorded(seed: int, *, half_hz: float | None, extra=friction, noise: float = 0.01) -> Recording:
    """Record a motion of the demo's arm; all signals are low-passed as people do, if a frequency is given."""
    one = simulated.record(
        URDF, seed, name=f"motion{seed}", extra=extra, torque_noise=noise, duration_s=30.0, fastest_hz=0.6
    )
    if half_hz is None:
        return one
    sos = signal.butter(4, half_hz * 2 / RATE_HZ, output="sos")
    t, q, tau = (np.concatenate([getattr(c, key) for c in one.chunks()]) for key in ("t", "q", "tau"))
    passed = (signal.sosfiltfilt(sos, x, axis=0) for x in (q, tau))
    return Recording.from_arrays(one.name, one.joints, t, *passed)


def low_pass_of(*recordings: Recording):
    robot, sources, settings = read_arguments(URDF, list(recordings), {}, "identify")
    reading, _ = read(robot, sources, settings)
    return reading.filtering.low_pass


@pytest.mark.parametrize("half_hz", [1.7, 3.0])
def test_the_filter_is_found(half_hz: float) -> None:
    found = low_pass_of(recorded(1, half_hz=half_hz))
    assert found is not None
    assert found.half_hz == pytest.approx(half_hz, rel=0.05)
    assert found.order in (3, 4, 5)


def test_no_filter_is_found_where_there_is_none() -> None:
    assert low_pass_of(recorded(1, half_hz=None)) is None


def test_a_smooth_motion_without_friction_is_not_taken_for_a_filter() -> None:
    smooth = recorded(1, half_hz=None, extra=None, noise=0.0)
    robot, sources, settings = read_arguments(URDF, [smooth], {}, "identify")
    reading, _ = read(robot, sources, settings)
    assert np.isfinite(reading.surveys[0].torque_ends_hz), "the torque ends where the motion does"
    assert find_low_pass(reading, 1) is None


def test_noisy_positions_under_exact_torques_are_not_taken_for_a_filter() -> None:
    noisy = simulated.record(URDF, 1, extra=None, torque_noise=0.0, encoder_noise=5e-4, duration_s=30.0, fastest_hz=0.6)
    assert low_pass_of(noisy) is None


def test_one_recording_without_the_filter_is_enough_to_have_none() -> None:
    assert low_pass_of(recorded(1, half_hz=1.7), recorded(2, half_hz=None)) is None


def test_held_out_recordings_do_not_decide() -> None:
    fitted, other = recorded(1, half_hz=1.7), recorded(2, half_hz=3.0)
    robot, sources, settings = read_arguments(URDF, [fitted], {"holdout": [other]}, "identify")
    reading, _ = read(robot, sources, settings)
    alone = low_pass_of(fitted)
    assert reading.filtering.low_pass == alone


def test_friction_is_identified_and_said() -> None:
    found = torchrbd.identify(URDF, [recorded(1, half_hz=1.7)], holdout=[recorded(2, half_hz=1.7)])
    values = {p.name: p.value for p in found.parameters}
    coulomb = [values[f"coulomb_friction_joint{k}.coulomb"] for k in range(1, 7)]
    np.testing.assert_allclose(coulomb, COULOMB, rtol=0.02)
    assert max(found.fits["extended"].nmse.values()) < 1e-4
    assert [fact.kind for fact in found.facts] == ["torques low-passed"]


def test_the_reported_error_is_found_again(tmp_path: Path) -> None:
    """By replaying the held-out recording alone, whose own filter would be estimated a little differently."""
    held_out = recorded(2, half_hz=1.7)
    found = torchrbd.identify(URDF, [recorded(1, half_hz=1.7)], holdout=[held_out])
    found.model.save(tmp_path / "model.safetensors")
    again = torchrbd.replay(tmp_path / "model.safetensors", [held_out])
    assert again.nmse == pytest.approx(again.reported, rel=1e-9)
    assert found.model.reported.low_pass is not None
    assert torchrbd.load_model(tmp_path / "model.safetensors").reported == found.model.reported


def test_the_filter_of_a_recording_that_the_model_does_not_know_is_estimated() -> None:
    found = torchrbd.identify(URDF, [recorded(1, half_hz=None)], holdout=[recorded(3, half_hz=None)])
    again = torchrbd.replay(found.model, [recorded(2, half_hz=1.7)])
    assert max(again.nmse.values()) < 1e-3


def test_known_loads_are_subtracted_as_they_would_have_been_recorded() -> None:
    robot, sources, settings = read_arguments(
        URDF, [recorded(1, half_hz=1.7)], {"payload": "motion1=3.0,0.1,0.0,0.2"}, "identify"
    )
    loaded, _ = read(robot, sources, settings)
    for before, after in zip(replace(loaded, payload={}).tiles(0), loaded.tiles(0), strict=True):
        known = after.decimate(after.taken_off(loaded.robot))
        left = before.decimate_torque(before.tau) - after.decimate_torque(after.tau)
        assert float(known.abs().max()) > 1.0
        torch.testing.assert_close(left, known, rtol=0, atol=1e-9)


@pytest.mark.skipif(real_sets.data_folder() is None, reason="TORCHRBD_DATA is not set")
def test_the_ur10s_torques_were_low_passed() -> None:
    own = real_sets.data_folder() / "ur10"
    robot, sources, settings = read_arguments(own / "robot.urdf", [own / "fit.csv"], {}, "identify")
    reading, _ = read(robot, sources, settings)
    assert reading.filtering.low_pass is not None
    assert reading.filtering.low_pass.half_hz == pytest.approx(1.75, abs=0.15)
