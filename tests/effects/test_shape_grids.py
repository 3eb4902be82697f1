"""Grids of shapes: fine enough for what lies between, and none where nothing could be told."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from effects.joint_torques import Values, rest
from effects.sites import ROBOT, SCALE

from torchrbd.effects import Effect, JointScale, Shape, Signals, Site
from torchrbd.effects.counterbalance import Counterbalance
from torchrbd.effects.joint_elasticity import JointElasticity
from torchrbd.effects.one_sided_spring import OneSidedSpring
from torchrbd.effects.position_dependent_friction import PositionDependentFriction
from torchrbd.effects.power_law_friction import PowerLawFriction
from torchrbd.effects.time_varying_friction import TimeVaryingFriction
from torchrbd.effects.torque_ripple import TorqueRipple
from torchrbd.effects.torque_saturation import TorqueSaturation

SHAPED = (
    PowerLawFriction(),
    TimeVaryingFriction(),
    PositionDependentFriction(),
    OneSidedSpring(),
    TorqueRipple(),
    Counterbalance(),
    TorqueSaturation(),
)


def matrix(effect: Effect, at: Signals, shape: Shape) -> Values:
    return torch.stack([*effect.features(at, Site(1), shape).values()], -1).numpy()


def motion(seed: int, n: int = 900) -> tuple[Signals, JointScale]:
    """Return a minute of motion that never repeats, and what it covers at joint 1, about 3 rad."""
    rng, t = np.random.default_rng(seed), np.linspace(0, 60, n)
    shape = (ROBOT.n_dof, 6, 1)
    omega, phase = 2 * np.pi * rng.uniform(0.05, 0.4, shape), rng.uniform(0, 6, shape)
    size = rng.uniform(0.3, 1.0, shape) / omega**0.5
    x = [(size * omega**k * np.sin(omega * t + phase + k * np.pi / 2)).sum(1) for k in range(3)]
    q, qd, qdd = (torch.from_numpy(v * (3.0 / np.ptp(x[0], axis=1))[:, None]) for v in x)
    fastest = float(qd[1].abs().max())
    width = torch.full((ROBOT.n_dof,), 2e-3 * fastest, dtype=torch.float64)
    at = Signals(ROBOT, q, qd, qdd, width, t=torch.from_numpy(t))
    load = float(at.load[1].abs().max())
    return at, JointScale(fastest, 2e-3 * fastest, float(q[1].min()), float(q[1].max()), load, float(t[-1]))


def drawn(effect: Effect, scale: JointScale, rng: np.random.Generator) -> dict[str, float]:
    """Draw parameters whose shapes lie anywhere in what the grid is made for."""
    span, low, load = scale.q_high - scale.q_low, scale.q_low, scale.load_max
    assert load is not None
    part = float(np.exp(rng.uniform(np.log(0.12), np.log(0.6))))
    match effect.id:
        case "power_law_friction":
            return {"friction": 1.0, "exponent": rng.choice([rng.uniform(0.25, 0.85), rng.uniform(1.15, 1.8)])}
        case "time_varying_friction":
            settles_s = scale.duration_s * (3.0 / scale.duration_s) ** rng.uniform()
            return {"coulomb_end": 1.0, "coulomb_start": 2.0, "time_constant": settles_s}
        case "position_dependent_friction":
            profile = float(rng.integers(2))
            width, edge = ((0.6 * part, 0.0), (0.5 * part, 0.5 * part))[int(profile)]
            shape = {"centre": low + rng.uniform(edge, 1 - edge) * span, "width": width * span, "profile": profile}
            return {**shape, "coulomb": 1.0, "coulomb_at_centre": 2.0}
        case "one_sided_spring":
            side = rng.choice([-1.0, 1.0])
            contact = scale.q_high - part * span if side > 0 else low + part * span
            return {"contact_position": contact, "side": side, "stiffness": 1.0}
        case "torque_ripple":
            return {"amplitude": 1.0, "phase": rng.uniform(-3, 3), "order": rng.uniform(3, 40)}
        case "counterbalance":
            spring, force, centre = rng.uniform(0, 2), rng.uniform(-2, 2), rng.uniform(-np.pi, np.pi)
            ratio = rng.uniform(0.2, 0.85)
            return {"spring_torque": spring, "force_torque": force, "dead_centre": centre, "crank_ratio": ratio}
        case _:
            return {"limit": rng.uniform(0.4, 0.9) * load, "slope": 1.0}


@pytest.mark.parametrize("effect", SHAPED, ids=lambda e: e.id)
class TestGrids:
    def test_some_shape_on_the_grid_shows_most_of_any_other(self, effect: Effect) -> None:
        """Of what viscous and Coulomb friction leave, a quarter of the power is lost at most, for nearly all truths."""
        rng, caught = np.random.default_rng(77), []
        for seed in (101, 102):
            at, scale = motion(seed)
            friction = np.stack([at.qd[1].numpy(), at.joint(1).direction().numpy()], -1)
            grid = [np.hstack([friction, matrix(effect, at, shape)]) for shape in effect.shapes(scale)]
            bases = [np.linalg.svd(X, full_matrices=False)[:2] for X in grid]
            for _ in range(40):
                w, shape = effect.coefficients(drawn(effect, scale, rng))
                tau = rest(matrix(effect, at, shape) @ np.array(w), friction)
                seen = max(np.linalg.norm(U[:, S / S[0] > 1e-10].T @ tau) for U, S in bases)
                caught.append(seen / np.linalg.norm(tau))
        assert np.quantile(caught, 0.1) > 0.75**0.5
        assert min(caught) > 0.75

    def test_shapes_are_distinct_and_few(self, effect: Effect) -> None:
        shapes = effect.shapes(SCALE)
        assert 2 <= len(shapes) <= 128
        assert len({tuple(shape.items()) for shape in shapes}) == len(shapes)
        at, _ = motion(103)
        labels = [tuple(effect.features(at, Site(1), shape)) for shape in shapes]
        assert len(set(labels)) == len(shapes)

    def test_shapes_are_plausible(self, effect: Effect) -> None:
        for shape in effect.shapes(SCALE):
            w = torch.ones(len(effect.units) - len(shape), dtype=torch.float64)
            found = effect.parameters(w, shape)
            assert effect.plausible({name: float(v) for name, v in found.items()}, SCALE)


@pytest.mark.parametrize("effect", [PositionDependentFriction(), OneSidedSpring(), TorqueRipple()], ids=lambda e: e.id)
def test_a_joint_that_stands_still_has_no_shapes(effect: Effect) -> None:
    assert effect.shapes(JointScale(1e-3, 1e-4, 0.3, 0.3)) == ()


def test_saturation_is_sought_below_the_largest_load() -> None:
    known, unknown = JointScale(1.0, 0.01, load_max=40.0), JointScale(1.0, 0.01)
    limits = [shape["limit"] for shape in TorqueSaturation().shapes(known)]
    np.testing.assert_allclose(limits, 40.0 * np.linspace(0.35, 0.88, 4))
    assert not TorqueSaturation().plausible({"limit": 41.0, "slope": 1.0}, known)
    assert TorqueSaturation().plausible({"limit": 41.0, "slope": 1.0}, unknown)
    # The estimate of a reading that is clipped, with its error.
    assert TorqueSaturation().plausible({"limit": 20.0, "slope": -1.02}, known)
    assert TorqueSaturation().shapes(JointScale(1.0, 0.01, load_max=0.0)) == ()


def test_time_constants_go_with_the_recordings_length() -> None:
    shortest, short, long = (
        [shape["time_constant"] for shape in TimeVaryingFriction().shapes(JointScale(1.0, 0.01, duration_s=d))]
        for d in (2.0, 30.0, 600.0)
    )
    # Grease needs seconds to settle, however short a recording is.
    assert shortest == [3.0]
    assert (min(short), max(short), min(long), max(long)) == pytest.approx((3.0, 30.0, 18.0, 600.0))
    for several in (short, long):
        np.testing.assert_allclose(np.diff(np.log(several), 2), 0.0, atol=1e-9)
    given = {"coulomb_end": 1.0, "coulomb_start": 2.0, "time_constant": 500.0}
    assert not TimeVaryingFriction().plausible(given, JointScale(1.0, 0.01, duration_s=30.0))
    assert TimeVaryingFriction().plausible(given, JointScale(1.0, 0.01, duration_s=600.0))
    assert not TimeVaryingFriction().plausible(given | {"time_constant": 1.0}, JointScale(1.0, 0.01, duration_s=30.0))


def test_a_spring_that_yields_further_than_it_can_tell_is_not_plausible() -> None:
    scale = JointScale(1.0, 0.01, load_max=40.0)
    assert JointElasticity().plausible({"stiffness": 1000.0, "bandwidth": 6.0}, scale)
    assert not JointElasticity().plausible({"stiffness": 100.0, "bandwidth": 6.0}, scale)


def test_centres_of_a_counterbalance_cover_the_turn_and_are_closer_in_the_range_of_motion() -> None:
    for low, high in ((-0.1, 2.0), (-3.0, 3.0), (-4.0, 5.0), (0.2, 0.2)):
        shapes = Counterbalance().shapes(JointScale(1.0, 0.01, low, high))
        for ratio in {shape["crank_ratio"] for shape in shapes}:
            own = np.sort([s["dead_centre"] for s in shapes if s["crank_ratio"] == ratio])
            gaps = np.diff(own, append=own[0] + 2 * np.pi)
            assert 0.05 < gaps.min() <= gaps.max() < 0.45
    closest = np.diff(np.sort([s["dead_centre"] for s in Counterbalance().shapes(SCALE) if s["crank_ratio"] > 0.6]))
    assert closest.min() < 0.7 * closest.max()


def test_ripple_has_whole_orders_on_its_grid() -> None:
    orders = [shape["order"] for shape in TorqueRipple().shapes(JointScale(1.0, 0.01, -3.0, 3.0))]
    assert orders[:3] == [2.0, 3.0, 4.0]
    assert {30.0, 50.0, 100.0, 200.0} <= set(orders)
    narrow = [shape["order"] for shape in TorqueRipple().shapes(JointScale(1.0, 0.01, 0.0, 0.3))]
    assert min(narrow) * 0.3 >= 2 * np.pi
    assert narrow[1] - narrow[0] == pytest.approx(np.pi / 0.3)
