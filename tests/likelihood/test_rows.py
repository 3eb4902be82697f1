"""Check rows against Pinocchio's torques, features one by one, and what is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from likelihood.arms import arm_urdf, friction, none_kept_back, reading_of, recorded, rows_of
from simulated import joint_names

from torchrbd.dataset import rows as rows_module
from torchrbd.dataset.remembered import Remembered
from torchrbd.dataset.rows import Rows, read_rows
from torchrbd.effects import Site
from torchrbd.effects.registry import effect
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

URDF = arm_urdf(0, 3)
ROBOT = RobotModel.from_urdf(URDF)
OPTIONS = {"duration_s": 12.0, "noise": 0.0}


def without(recording: Recording, name: str, keep: np.ndarray) -> Recording:
    (chunk,) = recording.chunks(10**7)
    return Recording.from_arrays(name, recording.joints, chunk.t[keep], chunk.q[keep], chunk.tau[keep])


@pytest.fixture(scope="module")
def clean() -> Rows:
    return rows_of(ROBOT, [recorded(URDF, 0, **OPTIONS)])


def test_regressor_times_parameters_is_pinocchios_torque(clean: Rows) -> None:
    predicted = clean.load(ROBOT.pi.numpy())
    rms = np.sqrt(np.mean(clean.tau**2, 1))
    assert (np.sqrt(np.mean((predicted - clean.tau) ** 2, 1)) < 2e-3 * rms).all()


def test_sizes_are_remembered_where_features_are_not(clean: Rows, monkeypatch: pytest.MonkeyPatch) -> None:
    rows, count = replace(clean, _known=Remembered(0), _rms={}), list[str]()
    evaluated = Rows.evaluated

    def counted(self: Rows, function) -> np.ndarray:
        count.append("once more")
        return evaluated(self, function)

    monkeypatch.setattr(Rows, "evaluated", counted)
    for name, site in (("torque_ripple", Site(1)), ("time_delay", Site())):
        e = effect(name)
        c = rows.columns.candidate(e, site, e.shapes(rows.columns.scale(site))[0])
        F = rows.features(c)
        np.testing.assert_allclose(rows.rms(c), np.linalg.norm(F, axis=-1) / np.sqrt(len(rows.t)))
        assert rows.rms(c) is rows.rms(c)
    assert len(count) == 2
    with_load = rows.around(2.0 * ROBOT.pi, torch.zeros(3, 3), np.full(3, 0.01))
    c = with_load.columns.candidate(effect("torque_scale"), Site(1), {})
    np.testing.assert_allclose(with_load.rms(c), 2.0 * rows.rms(c))


@pytest.mark.parametrize("of_motion", [False, True])
def test_states_that_are_thinned_make_the_same_rows(of_motion: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    fast = recorded(URDF, 1, duration_s=6.0, rate_hz=1000.0)
    thinned = rows_of(ROBOT, [fast], of_motion=of_motion, cutoff_hz=10.0)
    monkeypatch.setattr(rows_module, "_DENSITY", replace(rows_module._DENSITY, least_rate_hz=1e9))
    whole = rows_of(ROBOT, [fast], of_motion=of_motion, cutoff_hz=10.0)
    assert whole.tiles[0].states.t.shape[0] > 4 * thinned.tiles[0].states.t.shape[0]
    np.testing.assert_allclose(thinned.t, whole.t, atol=1e-9)
    np.testing.assert_allclose(thinned.tau, whole.tau, atol=1e-12)
    largest = max(np.abs(Y).max() for Y in whole.rigid)
    for few, many in zip(thinned.rigid, whole.rigid, strict=True):
        np.testing.assert_allclose(few, many, atol=1e-3 * largest)


def test_features_are_those_of_every_tile_through_the_filter(clean: Rows) -> None:
    c = clean.columns.candidate(effect("stribeck_friction"), Site(1), {"stribeck_speed": 0.1})
    first = clean.features(c)
    assert first.shape == (2, len(clean.t))
    assert clean.features(c) is first
    for k, name in enumerate(c.labels):
        one = clean.evaluated(lambda s, name=name: c.features(s)[name])
        np.testing.assert_allclose(first[k], one, rtol=1e-12)
    other = clean.columns.candidate(effect("stribeck_friction"), Site(1), {"stribeck_speed": 0.2})
    assert np.abs(clean.features(other)[1] - first[1]).max() > 1e-3
    np.testing.assert_allclose(clean.features(other)[0], first[0])
    np.testing.assert_allclose(clean.evaluated(lambda s: s.qd), clean.qd, atol=1e-12)
    np.testing.assert_allclose(clean.evaluated(lambda s: s.load), clean.load(ROBOT.pi.numpy()), atol=1e-9)


def test_effect_of_all_joints_has_features_at_each(clean: Rows) -> None:
    c = clean.columns.candidate(effect("time_delay"), Site(), {"step": 1e-3, "bandwidth": 6.0})
    assert clean.features(c).shape == (1, 3, len(clean.t))


def test_friction_is_the_same_through_features_and_torque() -> None:
    viscous, coulomb, width = [0.3, 0.2, 0.4], [0.5, 0.2, 0.3], 0.05
    fine = {"duration_s": 12.0, "noise": 0.0}
    plain, rubbed = (rows_of(ROBOT, [recorded(URDF, 2, f, **fine)]) for f in (None, friction(viscous, coulomb, width)))
    for j in range(3):
        got = coulomb[j] * plain.evaluated(lambda s, j=j: torch.tanh(s.qd[j] / width)) + viscous[j] * plain.qd[j]
        expected = rubbed.tau[j] - plain.tau[j]
        assert np.sqrt(np.mean((got - expected) ** 2)) < 0.01 * np.sqrt(np.mean(expected**2))


def test_rows_around_a_fit_have_its_load_and_friction(clean: Rows) -> None:
    pi = 1.3 * ROBOT.pi
    beside = torch.tensor([[0.1, 0.5, 0.0], [0.0, 0.2, 0.1], [0.0, 0.0, 0.0]], dtype=torch.float64)
    width = np.array([0.01, 0.05, 0.1])
    got = clean.around(pi, beside, width)
    load = clean.load(pi.numpy())
    np.testing.assert_allclose(got.evaluated(lambda s: s.load), load, atol=1e-9)
    expected = load[1] + got.evaluated(lambda s: 0.2 * torch.tanh(s.qd[1] / 0.05) + 0.1)
    np.testing.assert_allclose(got.evaluated(lambda s: s.supplied)[1], expected, atol=1e-9)
    assert [s.rest_width for s in got.columns.scales] == width.tolist()
    np.testing.assert_allclose([s.load_max for s in got.columns.scales], np.abs(load).max(1))
    c = clean.columns.candidate(effect("load_dependent_friction"), Site(0), {})
    assert np.abs(got.features(c) - clean.features(c)).max() > 0
    assert np.array_equal(got.tau, clean.tau)


def test_long_recordings_are_read_in_parts_that_are_spread(monkeypatch: pytest.MonkeyPatch) -> None:
    recordings = [recorded(URDF, k, name=f"r{k}", duration_s=200.0) for k in (0, 1)]
    whole = rows_of(ROBOT, recordings)
    monkeypatch.setattr(rows_module, "_DENSITY", replace(rows_module._DENSITY, most_states=25_000))
    some = rows_of(ROBOT, recordings)
    states = sum(tile.states.q.shape[1] for tile in some.tiles)
    assert 10_000 < states < 1.3 * 25_000
    assert set(some.recording) == {0, 1}
    for k in (0, 1):
        assert np.ptp(some.t[some.recording == k]) > 0.4 * np.ptp(whole.t[whole.recording == k])
    at = {(k, round(t, 6)): i for i, (k, t) in enumerate(zip(whole.recording, whole.t, strict=True))}
    same = [at[k, round(t, 6)] for k, t in zip(some.recording, some.t, strict=True)]
    np.testing.assert_allclose(some.tau, whole.tau[:, same], atol=1e-12)
    assert len(np.unique(some.run)) > 2
    assert len(np.unique(some.block)) <= 2 * 64 + 2


def test_what_is_kept_back_does_not_appear() -> None:
    recordings = [recorded(URDF, k, name=f"r{k}", duration_s=12.0) for k in (0, 1)]

    def kept_back(name: str, t: torch.Tensor) -> torch.Tensor:
        return (t > 4.0) & (t < 6.0) if name == "r0" else t >= 8.0

    whole, some = rows_of(ROBOT, recordings), rows_of(ROBOT, recordings, kept_back)
    out = np.where(whole.recording == 0, (whole.t > 4.0) & (whole.t < 6.0), whole.t >= 8.0)
    assert out.any()
    np.testing.assert_allclose(some.t, whole.t[~out])
    np.testing.assert_allclose(some.tau, whole.tau[:, ~out])
    np.testing.assert_allclose(some.qd, whole.qd[:, ~out])
    assert len(np.unique(some.run)) == 3
    c = whole.columns.candidate(effect("rotor_inertia"), Site(2), {})
    np.testing.assert_allclose(some.features(c), whole.features(c)[:, ~out])


def test_recording_that_is_kept_back_as_a_whole_has_no_rows() -> None:
    recordings = [recorded(URDF, k, name=f"r{k}", duration_s=8.0) for k in (0, 1)]
    rows = rows_of(ROBOT, recordings, lambda name, t: torch.full((len(t),), name == "r0"))
    assert set(rows.recording) == {1}
    assert rows.recordings == ("r0", "r1")


def disturbed(k: int, name: str, *, step: float = 0.0, **options: float) -> Recording:
    """Record with positions that are noisy, by an encoder that is worse, and torques rounded to steps."""
    one = recorded(URDF, k, name=name, **{**OPTIONS, "noise": 0.02, **options})
    (chunk,) = one.chunks(10**7)
    tau = step * np.round(chunk.tau / step) if step else chunk.tau
    return Recording.from_arrays(name, one.joints, chunk.t, chunk.q, tau)


def test_recording_that_is_kept_back_as_a_whole_is_not_looked_at() -> None:
    """Neither its clock nor its noise nor its rounding; nor is it read, which its clock would not allow."""
    own = disturbed(0, "own", encoder_noise=1e-4)
    for other in (
        disturbed(1, "other", encoder_noise=1e-3, step=0.5, rate_hz=100.0),
        disturbed(1, "other", encoder_noise=1e-3, rate_hz=20.0),
    ):
        reading, columns = reading_of(ROBOT, [own, other], cutoff_hz=12.0)
        got = read_rows(reading, columns, lambda name, t: torch.full((len(t),), name == "other"))
        alone = rows_of(ROBOT, [own], cutoff_hz=12.0)
        assert got.dt == alone.dt
        for name in ("encoder_std", "speed_std", "torque_step", "tau"):
            np.testing.assert_allclose(getattr(got, name), getattr(alone, name), rtol=1e-12)


def test_steps_of_the_torque_are_the_coarsest_that_any_recording_shows() -> None:
    plain, rounded = disturbed(0, "a"), disturbed(1, "b", step=0.5)
    assert np.isnan(rows_of(ROBOT, [plain]).torque_step).all()
    np.testing.assert_allclose(rows_of(ROBOT, [plain, rounded]).torque_step, 0.5, rtol=1e-3)


def test_torque_that_is_late_is_read_earlier() -> None:
    """By 12 ms, which is no whole number of samples."""
    late, together = (recorded(URDF, 11, delay_s=d, name="a", **OPTIONS) for d in (0.012, 0.0))
    reading, columns = reading_of(ROBOT, [late])
    got = read_rows(replace(reading, delay_s={"a": 0.012}), columns, none_kept_back)
    plain, expected = rows_of(ROBOT, [late]), rows_of(ROBOT, [together])
    np.testing.assert_allclose(got.t, expected.t)
    for own, other in zip(got.rigid, expected.rigid, strict=True):
        np.testing.assert_array_equal(own, other)
    scale = np.abs(expected.tau).max()
    # At the beginning of a recording the late torque is not what it was before.
    np.testing.assert_allclose(got.tau[:, 3:], expected.tau[:, 3:], atol=2e-3 * scale)
    assert np.abs(plain.tau - expected.tau).max() > 0.02 * scale
    other = replace(reading, delay_s={"other": 0.012})
    np.testing.assert_array_equal(read_rows(other, columns, none_kept_back).tau, plain.tau)


@pytest.mark.parametrize("rate_hz", [1000.0, 200.0])
def test_memory_is_bounded_whatever_divides_the_stride(rate_hz: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """At 1 kHz and 30 Hz the stride is 13, which is prime: nothing can be thinned."""
    monkeypatch.setattr(rows_module, "_DENSITY", replace(rows_module._DENSITY, most_states=15_000))
    one = recorded(URDF, 12, duration_s=66_000.0 / rate_hz, rate_hz=rate_hz)
    rows = rows_of(ROBOT, [one], cutoff_hz=None if rate_hz < 1000.0 else 30.0)
    tiles = [tile.states.q.shape[1] for tile in rows.tiles]
    assert 7_500 < sum(tiles) <= 1.05 * 15_000 + max(tiles)


def test_gap_starts_a_new_run() -> None:
    one = recorded(URDF, 3, duration_s=14.0)
    (chunk,) = one.chunks(10**7)
    gappy = without(one, "gappy", (chunk.t < 6.0) | (chunk.t > 7.0))
    rows = rows_of(ROBOT, [gappy])
    assert len(np.unique(rows.run)) == 2
    (jump,) = np.flatnonzero(np.diff(rows.run))
    assert rows.t[jump] < 6.0
    assert rows.t[jump + 1] > 7.0
    assert np.ptp(np.diff(rows.t)[np.diff(rows.run) == 0]) < 1e-9


def test_several_recordings_are_the_rows_of_each() -> None:
    recordings = [recorded(URDF, k, name=f"r{k}", duration_s=8.0) for k in (4, 5)]
    both, single = rows_of(ROBOT, recordings), [rows_of(ROBOT, [r]) for r in recordings]
    np.testing.assert_allclose(both.tau, np.concatenate([r.tau for r in single], 1))
    for together, *apart in zip(both.rigid, *(r.rigid for r in single), strict=True):
        np.testing.assert_allclose(together, np.concatenate(apart))
    assert (np.diff(both.run) != 0).sum() == 1
    assert not set(both.block[both.recording == 0]) & set(both.block[both.recording == 1])


def test_joint_without_torque_is_not_seen() -> None:
    missing = joint_names(URDF)[1]
    recordings = [recorded(URDF, 6, name="a", missing=[missing], duration_s=8.0), recorded(URDF, 7, duration_s=8.0)]
    only, both = rows_of(ROBOT, recordings[:1]), rows_of(ROBOT, recordings)
    assert only.seen == [True, False, True]
    assert not only.tau[1].any()
    assert both.seen == [True, True, True]
    np.testing.assert_array_equal(both.measured[1], both.recording == 1)


def test_clock_and_encoder_noise_are_those_of_the_recordings() -> None:
    reading, columns = reading_of(
        ROBOT,
        [
            recorded(URDF, 8, name="a", encoder_noise=1e-4, duration_s=8.0),
            recorded(URDF, 9, duration_s=8.0, rate_hz=100.0, encoder_noise=3e-4),
        ],
    )
    rows = read_rows(reading, columns, none_kept_back)
    np.testing.assert_allclose(rows.encoder_std, np.sqrt((1e-4**2 + 3e-4**2) / 2), rtol=0.1)
    assert rows.dt == pytest.approx(0.01)
    assert rows.dt_out == pytest.approx(max(reading.filtering.stride(dt) * dt for dt in (0.005, 0.01)))
