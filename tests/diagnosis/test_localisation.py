"""What is concealed in field-like recordings is found where it sits, and nothing where nothing is."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis.concealed_field import CONCEALED, Case, background, case
from robot.random_robots import random_urdf
from scipy.interpolate import CubicSpline
from simulated import Motion, inverse_dynamics, joint_names, multisine

from torchrbd.diagnosis import Location
from torchrbd.diagnosis.localisation import locate
from torchrbd.recordings import Recording


def located(one: Case) -> tuple[Location, ...]:
    return tuple(x for x in locate(background(one))[0] if x.model == "rigid_body")


def overlap(a: tuple[float, float], b: tuple[float, float]) -> float:
    return max(0.0, min(a[1], b[1]) - max(a[0], b[0])) / (max(a[1], b[1]) - min(a[0], b[0]))


@pytest.mark.slow
def test_nothing_is_located_where_nothing_is() -> None:
    assert located(case(50)) == ()


@pytest.mark.parametrize("effect", [pytest.param("step", marks=pytest.mark.slow), "rubbing"])
def test_what_begins_and_ends_is_located_in_time(effect: str) -> None:
    one = case(51, CONCEALED[effect])
    assert one.truth is not None
    assert one.truth.time_s is not None
    (found,) = located(one)
    assert found.joints == (f"joint{one.truth.joint + 1}",)
    assert found.course == "abrupt"
    assert found.where.time_s is not None
    np.testing.assert_allclose(found.where.time_s[0], one.truth.time_s, atol=0.3)


@pytest.mark.parametrize("effect", ["sticky", pytest.param("cable", marks=pytest.mark.slow)])
def test_what_sits_at_a_position_is_located_there(effect: str) -> None:
    one = case(52, CONCEALED[effect])
    assert one.truth is not None
    assert one.truth.region is not None
    found = located(one)[0]
    assert found.joints == (f"joint{one.truth.joint + 1}",)
    assert found.depends_on == (one.truth.signal,)
    assert found.where.region is not None
    assert overlap((found.where.region[0].low, found.where.region[0].high), one.truth.region) > 0.7
    assert found.curve is not None
    assert found.curve.signal == one.truth.signal


@pytest.mark.slow
def test_what_fades_is_called_slow() -> None:
    found = located(case(53, CONCEALED["warming"]))[0]
    assert (found.form, found.course, found.depends_on) == ("friction", "slow", ("t",))
    assert found.where.time_s is None


def test_a_push_is_located_on_its_link_with_force_and_point() -> None:
    one = case(54, CONCEALED["push"])
    assert one.truth is not None
    assert one.truth.time_s is not None
    assert one.truth.force is not None
    found = located(one)[0]
    assert found.links == (one.truth.link,)
    assert found.where.time_s is not None
    np.testing.assert_allclose(found.where.time_s[0], one.truth.time_s, atol=0.3)
    assert found.attack is not None
    off = np.subtract(found.attack.force, one.truth.force) / found.attack.force_std
    aside = np.subtract(found.attack.point, one.truth.point) / found.attack.point_std
    assert max(np.abs(off).max(), np.abs(aside).max()) < 4.0
    assert np.linalg.norm(found.attack.force_std) < 0.5 * np.linalg.norm(one.truth.force)


@pytest.mark.slow
def test_only_the_recording_that_holds_it_is_named() -> None:
    one = case(55, CONCEALED["step"])
    assert one.truth is not None
    found, maps = locate(background(one, one.recording, one.holdout))
    assert found[0].where.recordings == ("field",)
    assert found[0].joints == (f"joint{one.truth.joint + 1}",)
    assert {(m.signal, m.recording) for m in maps} == {("t", "field"), ("t", "other"), ("q", ""), ("qd", "")}


@pytest.mark.slow
def test_the_map_is_loud_where_it_is() -> None:
    one = case(51, CONCEALED["rubbing"])
    assert one.truth is not None
    assert one.truth.time_s is not None
    maps = locate(background(one))[1]
    time = next(m for m in maps if m.signal == "t")
    centre = np.convolve(time.edges[one.truth.joint], [0.5, 0.5], "valid")
    inside = (centre > one.truth.time_s[0]) & (centre < one.truth.time_s[1])
    level = np.array(time.level)
    assert np.nanmean(level[one.truth.joint, inside]) > 2 * np.nanmean(level[one.truth.joint, ~inside])
    others = np.delete(level, one.truth.joint, axis=0)
    assert 0.7 < np.nanmean(others) < 1.5


def test_nothing_is_located_in_some_seconds_of_nothing() -> None:
    assert located(case(57, duration_s=12.0)) == ()


def test_what_acts_while_the_robot_rests_is_located_at_its_joint() -> None:
    urdf, pause = random_urdf(60, 4, kinds=("revolute",), branching=0.0, massless=0.0), (12.0, 15.0)
    moved = multisine(4, 60, rate_hz=125.0)
    rate = 1.0 - 0.5 * (np.tanh((moved.t - pause[0]) / 0.15) - np.tanh((moved.t - pause[1]) / 0.15))
    at = np.cumsum(rate) * (moved.t[1] - moved.t[0])
    q, qd, qdd = (CubicSpline(moved.t, x)(at) for x in (moved.q, moved.qd, moved.qdd))
    motion = Motion(moved.t, q, qd * rate[:, None], qdd * rate[:, None] ** 2 + qd * np.gradient(rate, moved.t)[:, None])
    tau = inverse_dynamics(urdf, motion) + 0.2 * motion.qd
    tau[:, 1] += 4.0 * (rate < 0.01)
    tau += 0.02 * np.sqrt(np.mean(tau**2, 0)) * np.random.default_rng(60).standard_normal(tau.shape)
    recording = Recording.from_arrays("rests", joint_names(urdf), motion.t, q, tau)
    assert any(x.joints == ("joint2",) for x in located(Case(urdf, urdf, recording, recording, None)))


@pytest.mark.slow
def test_joints_links_times_and_regions_on_recordings_never_seen() -> None:
    right, ends, overlaps = [], [], []
    for concealed in CONCEALED.values():
        for seed in range(500, 510):
            one = case(seed, concealed)
            found, truth = located(one), one.truth
            assert truth is not None
            joints = found[0].joints if found else ()
            right.append(f"joint{truth.joint + 1}" in (joints if truth.link else joints[:1]))
            if truth.time_s is not None:
                span = found[0].where.time_s if found else None
                ends += [np.inf, np.inf] if not span else list(np.abs(np.subtract(span[0], truth.time_s)))
            if truth.region is not None:
                regions = found[0].where.region if found else None
                same = regions and regions[0].signal == truth.signal
                overlaps.append(overlap((regions[0].low, regions[0].high), truth.region) if regions and same else 0.0)
    alarms = [len({j for x in located(case(seed)) for j in x.joints}) / (5 + seed % 3) for seed in range(500, 515)]
    assert np.mean(right) >= 0.97
    assert np.median(ends) < 0.3
    assert np.median(overlaps) > 0.7
    assert np.mean(alarms) <= 0.02
