"""Hums in what a fit leaves: frequency, size and joint; none in noise, and none where the motion repeats itself."""

from __future__ import annotations

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import Motion, multisine, record

from torchrbd.diagnosis.locate import hums
from torchrbd.diagnosis.locate.hum import repeats
from torchrbd.diagnosis.results import Location
from torchrbd.diagnosis.rows.regression import fitted
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.search.options import BACKGROUND
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.physics import Site, effect
from torchrbd.robot import RobotModel

URDF = random_urdf(8, 3, kinds=("revolute",), branching=0.0, massless=0.0)
FREQUENCY_HZ, AMPLITUDE = 2.73, 0.3


def found(hum: float) -> tuple[Location, ...]:
    """Return the hums of two recordings with one at joint 1 of this amplitude, of another phase in each."""

    def extra(motion: Motion) -> np.ndarray:
        torque = np.zeros_like(motion.q)
        torque[:, 1] = hum * np.sin(2 * np.pi * FREQUENCY_HZ * motion.t + 10.0 * motion.q[0, 0])
        return torque

    options = {"duration_s": 20.0, "rate_hz": 125.0}
    sources = [record(URDF, 8 + k, extra=extra, name=f"{k}.csv", **options) for k in range(2)]
    prepared = prepare(RobotModel.from_urdf(URDF), sources, Settings.from_mapping({"cutoff_hz": 6.0}, "test"), ())
    samples = read_samples(prepared, prepared.fit().pi)
    terms = [samples.columns.candidate(effect(name), Site(j), {}) for j in range(3) for name in BACKGROUND]
    return hums(fitted(samples, prepared.prior, terms), "extended")


def test_a_hum_is_told_by_frequency_and_size() -> None:
    (one,) = found(AMPLITUDE)
    assert one.joints == (RobotModel.from_urdf(URDF).joint_names[1],)
    assert one.depends_on == ("t",)
    assert one.form == "hum"
    assert one.where.region is not None
    (band,) = one.where.region
    assert band.low < FREQUENCY_HZ < band.high
    assert band.high - band.low < 0.4
    assert one.torque_rms[one.joints[0]] == pytest.approx(AMPLITUDE / np.sqrt(2), rel=0.1)


def test_noise_does_not_hum() -> None:
    assert found(0.0) == ()


def test_a_motion_that_repeats_itself_is_known() -> None:
    t = np.arange(0.0, 30.0, 0.05)
    harmonics = np.array([[np.sin(2 * np.pi * k * t / 8.0 + k * j) / k for k in (1, 2, 3)] for j in range(3)]).sum(1)
    noise = 0.01 * np.random.default_rng(0).standard_normal(harmonics.shape)
    assert repeats(harmonics + noise)
    assert not repeats(harmonics[:, : len(t) // 4] + noise[:, : len(t) // 4])
    assert not repeats(multisine(3, 4, duration_s=30.0, rate_hz=20.0).q.T)


def test_where_the_motion_repeats_itself_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torchrbd.diagnosis.locate.hum.repeats", lambda q: True)
    assert found(AMPLITUDE) == ()
