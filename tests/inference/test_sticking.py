"""Joints that stick: their samples count less, by a formula and against MuJoCo's dry friction."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from importlib.resources import files

import mujoco
import numpy as np
import pytest
import torch
from inference.problems import columns_of, dense, recorded, statistics_of, stream

from torchrbd.dataset.columns import Columns
from torchrbd.dataset.scales import covered_scales
from torchrbd.dataset.sticking import stick_weight, undetermined
from torchrbd.effects import effect
from torchrbd.inference.identify import identify
from torchrbd.inference.physical.fitting import fit_model, term_candidates
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.inference.stick_levels import stick_levels
from torchrbd.likelihood.urdf_prior import data_prior
from torchrbd.recordings import Filtering, Recording, survey
from torchrbd.robot import RobotModel

URDF = """<robot name="pendulum"><link name="base"/>
<link name="arm"><inertial><origin xyz="0 0 -0.4"/><mass value="{mass}"/>
<inertia ixx="0.05" iyy="0.05" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint></robot>"""
STEP, EVERY, TORQUE_NOISE, COULOMB, VISCOUS = 0.0005, 8, 0.1, 0.8, 0.2


@dataclass(frozen=True)
class Sticky:
    """A recording, and the true speed (N,)."""

    recording: Recording
    qd: np.ndarray


def pendulum(seed: int, coulomb: float, duration_s: float = 30.0) -> Sticky:
    """Let MuJoCo move a pendulum along sines with pauses; its controller knows of the friction in motion."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(URDF.format(mass=2.0))  # type: ignore[attr-defined]
    model.opt.timestep = STEP
    model.dof_frictionloss[:], model.dof_damping[:] = coulomb, VISCOUS
    model.dof_solref[:], model.dof_solimp[:] = [2 * STEP, 1.0], [0.999, 0.999, 0.001, 0.5, 2.0]
    data = mujoco.MjData(model)  # type: ignore[attr-defined]
    t = STEP * np.arange(round(duration_s / STEP))
    knots = np.arange(0.0, duration_s + 2.0, 1.0)
    pace = np.interp(t, knots, rng.random(len(knots)) > 0.3)
    clock = STEP * np.cumsum(pace)
    omega, phase = 2 * np.pi * np.array([0.11, 0.29, 0.53]), rng.uniform(0, 2 * np.pi, 3)
    wanted = 0.5 * np.sin(omega * clock[:, None] + phase).sum(1)
    known = coulomb * np.tanh(np.gradient(wanted, STEP) / 0.05)
    data.qpos[0] = wanted[0]
    q, qd, tau = np.empty((3, len(t)))
    for k, goal in enumerate(wanted):
        q[k], qd[k] = data.qpos[0], data.qvel[0]
        tau[k] = 300.0 * (goal - q[k]) - 25.0 * qd[k] + known[k]
        data.qfrc_applied[0] = tau[k]
        mujoco.mj_step(model, data)  # type: ignore[attr-defined]
    tau = tau[::EVERY] + TORQUE_NOISE * rng.standard_normal(len(tau[::EVERY]))
    q = q[::EVERY] + 1e-6 * rng.standard_normal(len(tau))
    return Sticky(Recording.from_arrays("sticky", ("hinge",), t[::EVERY], q[:, None], tau[:, None]), qd[::EVERY])


EFFECTS = ("viscous_friction", "coulomb_friction", "presliding_hysteresis", "stribeck_friction")


def prepared_of(sticky: Sticky) -> Prepared:
    robot = RobotModel.from_urdf(URDF.format(mass=1.7))
    settings = Settings(cutoff_hz=6.0, estimator="physical", kappa=0.01)
    return prepare(robot, [sticky.recording], settings, [effect(e) for e in EFFECTS])


@pytest.fixture(scope="module")
def sticky() -> Sticky:
    return pendulum(5, COULOMB)


@pytest.fixture(scope="module")
def prepared(sticky: Sticky) -> Prepared:
    return prepared_of(sticky)


def unweighted(prepared: Prepared) -> Prepared:
    """Return the same with every sample at its full weight."""
    columns = prepared.columns.sticking(torch.zeros(1, dtype=torch.float64))
    return replace(prepared, columns=columns, statistics=prepared.reading.statistics(columns, lambda *_: None))


def noise_variance(prepared: Prepared) -> float:
    """Return what the feature filter leaves of white torque noise."""
    return TORQUE_NOISE**2 * float(prepared.filtering.feature_kernel(STEP * EVERY).square().sum())


def false_gain(prepared: Prepared, name: str) -> float:
    """Return the most that a shape of an effect gains beside friction, in units of 2 log-likelihood."""
    friction = prepared.columns.urdf_friction
    before = prepared.fit(friction)

    def error(model) -> float:
        return float(prepared.training.squared_error(model.x).sum()) / float(before.noise_variance)

    shapes = [c for c in prepared.columns.candidates if c.effect.id == name]
    assert shapes
    return max(error(before) - error(prepared.fit((*friction, c), before.noise_variance)) for c in shapes)


def test_the_formula() -> None:
    rng = np.random.default_rng(0)
    qd, width, level = rng.normal(size=(2, 50)), np.array([0.1, 0.4]), np.array([0.0, 7.0])
    u = 1 - np.abs(np.tanh(qd / (4 * width[:, None])))
    found = undetermined(torch.from_numpy(qd), torch.from_numpy(width))
    torch.testing.assert_close(found, torch.from_numpy(u))
    weight = stick_weight(found, torch.from_numpy(level))
    torch.testing.assert_close(weight, torch.from_numpy(1 / (1 + (10 * level[:, None] * u) ** 2)))
    assert (weight[0] == 1).all()
    assert stick_weight(torch.ones(1, 1), torch.tensor([50.0])) < 1e-5


def test_moments_are_those_of_weighted_rows() -> None:
    robot, recording = recorded(2, 3)
    columns = columns_of(robot).sticking(torch.tensor([0.0, 3.0, 30.0], dtype=torch.float64))
    full, (states,) = dense(columns, recording), stream(recording, 10**7)
    weight = columns.weight(states).numpy()
    assert (weight[0] == 1).all()
    assert (weight[1:] < 0.5).any()
    assert weight.min() > 0
    statistics = statistics_of(columns, recording)
    for j, own in enumerate(columns.of_joint):
        w = full.weight * weight[j]
        a = np.column_stack((full.A[j][:, own.numpy()], full.tau[j]))
        np.testing.assert_allclose(statistics.total()[j], (a * w[:, None]).T @ a, rtol=1e-8, atol=1e-8 * len(w))
        expected = [w.sum(), w @ full.tau[j], w @ full.tau[j] ** 2]
        np.testing.assert_allclose(statistics.torque.sum(0)[j], expected, rtol=1e-8)


def test_layouts_made_from_one_another_keep_the_levels(prepared: Prepared) -> None:
    columns, levels = prepared.columns, prepared.columns.stick_levels
    assert levels > 0
    others: list[Columns] = [
        columns.at_scales(columns.scales),
        columns.around(prepared.robot.pi),
        columns.of_candidates(columns.candidates[:1], None),
    ]
    for other in others:
        assert torch.equal(other.stick_levels, levels)
    wider = columns.softened([replace(s, rest_width=9.0 * s.rest_width) for s in columns.scales])
    assert wider.scales[0].rest_width == 9.0 * columns.scales[0].rest_width
    for states in prepared.tiles(0):
        for other in (wider, wider.around(prepared.robot.pi), wider.at_scales(wider.scales)):
            assert torch.equal(other.weight(states), columns.weight(states))
    width = prepared.fit(term_candidates(columns, ["coulomb_friction"])).module().rest_width
    assert width.tolist() == [s.rest_width for s in columns.scales]


def test_the_level_is_friction_over_noise(prepared: Prepared) -> None:
    """Sticks leave more than noise in most blocks at first, so that it comes out lower."""
    part = float(prepared.columns.stick_levels) / (COULOMB / noise_variance(prepared) ** 0.5)
    assert 0.3 < part < 1.2


def test_samples_that_see_nothing_but_rest_count_little_and_those_of_sliding_all(
    prepared: Prepared, sticky: Sticky
) -> None:
    weights, rests, slides = [], [], []
    (width,) = (s.rest_width for s in prepared.columns.scales)
    for states in prepared.tiles(0):
        first = round(float(states.t[0]) / states.dt)
        speed = torch.from_numpy(np.abs(sticky.qd[first : first + len(states.t)]))
        taps, stride = len(prepared.filtering.feature_kernel(states.dt)), prepared.filtering.stride(states.dt)
        windows = speed.unfold(0, taps, stride)
        weights.append(prepared.columns.weight(states)[0])
        rests.append((windows < 0.3 * width).all(1))
        slides.append((windows > 20 * width).all(1))
    weight, rest, slide = torch.cat(weights), torch.cat(rests), torch.cat(slides)
    assert rest.any()
    assert slide.any()
    assert weight[rest].max() < 0.01
    assert weight[slide].min() > 0.9


def test_what_is_left_is_torque_noise_and_nothing_else_is_found(prepared: Prepared) -> None:
    plain, noise = unweighted(prepared), noise_variance(prepared)
    terms = prepared.columns.urdf_friction
    assert float(prepared.fit(terms).noise_variance) == pytest.approx(noise, rel=0.3)
    assert float(plain.fit(terms).noise_variance) > 2 * noise
    assert false_gain(plain, "presliding_hysteresis") > 25
    assert false_gain(prepared, "presliding_hysteresis") < 15
    assert false_gain(prepared, "stribeck_friction") < 15


def test_friction_is_found_as_it_is(prepared: Prepared) -> None:
    model = prepared.fit(prepared.columns.urdf_friction)
    found = {c.effect.id: float(model.coefficients(c)[0]) for c in prepared.columns.urdf_friction}
    assert found["coulomb_friction"] == pytest.approx(COULOMB, rel=0.03)
    assert found["viscous_friction"] == pytest.approx(VISCOUS, rel=0.15)


def test_no_friction_no_level() -> None:
    """All rest counts, where nothing holds the joint but its torque."""
    free = prepared_of(pendulum(6, 0.0, 15.0))
    assert float(free.columns.stick_levels) < 0.5
    weight = torch.cat([free.columns.weight(states)[0] for states in free.tiles(0)])
    assert weight.mean() > 0.9


def test_a_joint_that_never_moves_may_be_held_by_friction_that_is_not_told(prepared: Prepared) -> None:
    (scale,) = prepared.columns.scales
    still = unweighted(prepared).columns.at_scales([replace(scale, speed_max=2 * scale.rest_width)])
    statistics = prepared.reading.statistics(still, lambda *_: None)
    held = still.sticking(stick_levels(statistics, data_prior(statistics, (), 3.0)))
    resting = torch.cat([held.weight(replace(tile, qd=0 * tile.qd))[0] for tile in prepared.tiles(0)])
    assert 0 < resting.max() < 0.05


def test_a_joint_that_covers_some_steps_of_its_encoder_rests() -> None:
    t, step = np.arange(0, 40, 0.004), 2 * np.pi / 2**15
    for amplitude, moves in ((5.0, False), (500.0, True)):
        q = np.round(amplitude * np.sin(0.2 * t))[:, None] * step
        recording = Recording.from_arrays("quantised", ("hinge",), t, q, np.cos(t)[:, None])
        (scale,) = covered_scales([survey(recording)], Filtering(6.0))
        assert scale.moves == moves


def test_levels_do_not_depend_on_units(prepared: Prepared) -> None:
    """Torques and inertias a thousand times as large."""
    plain = unweighted(prepared)
    scaled = tuple(m.clone() for m in plain.statistics.moments)
    for m in scaled:
        m[:, -1, :] *= 1e3
        m[:, :, -1] *= 1e3
    torque = plain.statistics.torque * torch.tensor([1.0, 1e3, 1e6], dtype=torch.float64)
    larger = replace(plain.statistics, moments=scaled, torque=torque)
    levels = [stick_levels(s, data_prior(s, (), 0.001)) for s in (plain.statistics, larger)]
    torch.testing.assert_close(levels[0], levels[1], rtol=0.05, atol=0.0)
    assert fit_model(larger, data_prior(larger, (), 0.001), larger.columns.urdf_friction).converged


@pytest.mark.slow
def test_rows_at_rest_count_little_though_the_likelihood_explains_them() -> None:
    """The bundled arm: what holds its joint at rest bends identification, which has no columns of it, by .05 N m."""
    demo = files("torchrbd") / "demo"
    truth = json.loads((demo / "truth.json").read_text())
    found = identify(str(demo / "arm.urdf"), str(demo / "fit.parquet"))
    (friction,) = (t for t in found.model.terms if t.effect.id == "asymmetric_coulomb_friction" and t.site.joint == 2)
    assert list(friction.parameters_by_name().values()) == pytest.approx([truth["value"]] * 2, abs=0.02)
