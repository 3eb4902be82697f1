"""Hums and wandering torque in what a fit leaves: frequency, size, joint; none in noise or where motion repeats."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import Motion, multisine, record

from torchrbd.diagnosis.locate import hums, wanders
from torchrbd.diagnosis.locate.hum import repeats
from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.physics import Site, effect
from torchrbd.physics.registry import PLAIN
from torchrbd.robot import RobotModel

URDF = random_urdf(8, 3, kinds=("revolute",), branching=0.0, massless=0.0)
FREQUENCY_HZ, AMPLITUDE, WANDERING = 2.73, 0.3, 0.3


def fitted_with(added: Callable[[Motion], np.ndarray]) -> Fit:
    """Return a fit to two recordings with a torque (M,) added at joint 1."""

    def extra(motion: Motion) -> np.ndarray:
        torque = np.zeros_like(motion.q)
        torque[:, 1] = added(motion)
        return torque

    options = {"duration_s": 20.0, "rate_hz": 125.0}
    sources = [record(URDF, 8 + k, extra=extra, name=f"{k}.csv", **options) for k in range(2)]
    prepared = prepare(RobotModel.from_urdf(URDF), sources, Settings.from_mapping({"cutoff_hz": 6.0}, "test"), ())
    samples = read_samples(prepared, prepared.fit().pi)
    terms = [samples.columns.candidate(effect(name), Site(j), {}) for j in range(3) for name in PLAIN]
    return fitted(samples, prepared.prior, terms)


def hum(motion: Motion) -> np.ndarray:
    """Return a hum of another phase in each recording."""
    return AMPLITUDE * np.sin(2 * np.pi * FREQUENCY_HZ * motion.t + 10.0 * motion.q[0, 0])


def walk(motion: Motion) -> np.ndarray:
    """Return a random walk, another in each recording."""
    at = np.arange(0.0, motion.t[-1] + 1.0, 0.5)
    steps = np.random.default_rng(int(1e6 * abs(motion.q[0, 0]))).standard_normal(len(at))
    return WANDERING * np.interp(motion.t, at, np.cumsum(steps))


def test_a_hum_is_told_by_frequency_and_size() -> None:
    fit = fitted_with(hum)
    (one,) = hums(fit, "extended")
    assert wanders(fit, "extended") == ()
    assert one.joints == (RobotModel.from_urdf(URDF).joint_names[1],)
    assert one.depends_on == ("t",)
    assert one.form == "hum"
    assert one.where.region is not None
    (band,) = one.where.region
    assert 0.5 * (band.low + band.high) == pytest.approx(FREQUENCY_HZ, abs=0.01)
    assert band.high - band.low < 0.4
    assert one.torque_rms[one.joints[0]] == pytest.approx(AMPLITUDE / np.sqrt(2), rel=0.1)


def test_a_wandering_torque_is_told_by_its_size() -> None:
    fit = fitted_with(walk)
    (one,) = wanders(fit, "extended")
    assert one.joints == (RobotModel.from_urdf(URDF).joint_names[1],)
    assert (one.form, one.depends_on, one.course) == ("wander", ("t",), "slow")
    # What wanders more slowly than a run lasts is not counted.
    assert 0.3 < one.torque_rms[one.joints[0]] / fit.leftover()[1].std() < 1.0
    assert hums(fit, "extended") == ()


def test_noise_neither_hums_nor_wanders() -> None:
    fit = fitted_with(lambda motion: np.zeros_like(motion.t))
    assert hums(fit, "extended") == ()
    assert wanders(fit, "extended") == ()


def test_a_motion_that_repeats_itself_is_known() -> None:
    t = np.arange(0.0, 30.0, 0.05)
    harmonics = np.array([[np.sin(2 * np.pi * k * t / 8.0 + k * j) / k for k in (1, 2, 3)] for j in range(3)]).sum(1)
    noise = 0.01 * np.random.default_rng(0).standard_normal(harmonics.shape)
    assert repeats(harmonics + noise)
    assert not repeats(harmonics[:, : len(t) // 4] + noise[:, : len(t) // 4])
    assert not repeats(multisine(3, 4, duration_s=30.0, rate_hz=20.0).q.T)


def test_where_the_motion_repeats_itself_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torchrbd.diagnosis.locate.hum.repeats", lambda q: True)
    assert hums(fitted_with(hum), "extended") == ()
