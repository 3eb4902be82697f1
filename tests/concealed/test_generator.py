"""The concealed benchmark's generator: MuJoCo's motion against Pinocchio's torque, effect by effect."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from concealed import cases, tiers
from concealed.absorbed import absorbed_effect
from concealed.background import Background
from concealed.cases import EVERY, make_case
from concealed.contract import Effect, Window
from concealed.effects import EFFECTS, NAMED, OUTSIDE
from concealed.generate import write_case
from concealed.motion import Motion, draw_path, expected, finer
from concealed.robots import PUBLIC, SETS, Robot, public_robot, random_robot
from concealed.simulate import STEP, Controller, Refused, Run, simulate
from concealed.sizes import Yardstick
from scipy.integrate import solve_ivp
from shortened import slow_but

SECONDS, FILE = 5.0, "fit_1.parquet"
# One of each way to act: friction solver, damping, push, hidden state, MuJoCo's model, window, wrench, sensor, drive.
QUICK = (
    "stribeck_friction", "quadratic_drag", "joint_coupling", "presliding_hysteresis", "geometry_error", "payload",
    "external_wrench", "time_delay", "actuator_lag",
)  # fmt: skip


class Bench:
    """A robot on a motion, to try effects on."""

    def __init__(self, robot: Robot, seed: int, *, computed: bool = False, pace: float = 25.0) -> None:
        rng = np.random.default_rng(seed)
        self.robot, self.rng = robot, rng
        self.path = draw_path(rng, robot, "sines", SECONDS, 1 / STEP)
        self.temperature = np.linspace(25.0, 45.0, len(self.path.t))[:, None] + np.zeros(robot.n)
        self.x = expected(robot, self.path.every(EVERY), FILE, self.temperature[::EVERY])
        held, free = robot.inertias(self.x.q)
        self.controller = Controller(robot, np.sqrt(held * free), pace, computed)

    def run(self, effects: list[Effect], background: Background | None = None) -> tuple[Run, Motion, np.ndarray]:
        """Simulate; return the run, the recorded motion and the torque that the effects added to what is recorded."""
        background = background or Background.none(self.robot.n)
        known = background.compensation(self.x.qd) + (0.0 if self.controller.computed else self.x.load)
        setting = (self.path, self.controller, finer(self.x.t, known, self.path.t), FILE, self.temperature)
        run = simulate(self.robot, background, effects, *setting)
        x, tau = run.motion(self.robot, effects, EVERY)
        return run, x, tau - x.load - background.torque(x)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(random_robot("development", 4), 3)


@pytest.mark.parametrize("computed", [False, True])
@pytest.mark.parametrize("name", ["panda", "ur10"])
def test_torque_without_effects_is_pinocchios(name: str, computed: bool) -> None:
    of = next(of for of in SETS if name in PUBLIC[of])
    _, x, left = Bench(public_robot(of, name), 1, computed=computed).run([])
    assert np.abs(x.load).max() > 5.0
    assert np.abs(left).max() < 1e-6


def test_wrong_inertials_move_a_controller_that_trusts_them_off_its_path() -> None:
    robot = random_robot("development", 4)
    bench = Bench(robot, 3)
    wrong = robot.with_cad_error(5, 0.3)
    off = wrong.torque(bench.x.q, bench.x.qd, bench.x.qdd) - bench.x.load
    assert np.sqrt((off**2).mean()) > 0.03 * np.sqrt((bench.x.load**2).mean())
    for body in list(wrong.model.inertias)[1:]:
        a, b, c = np.linalg.eigvalsh(body.inertia)
        assert min(body.mass, a) > 0
        assert a + b >= c


def drawn(bench: Bench, kind: str, size: float) -> tuple[Effect, Yardstick]:
    """Draw an effect of a size at the first joint that can have it."""
    yardstick = Yardstick([bench.x], [bench.x.load])
    for joint in range(bench.robot.n):
        for seed in range(3):
            effect = EFFECTS[kind].draw(np.random.default_rng([seed, 77]), bench.x, joint)
            effect.window = Window(FILE, 1.0, 4.0) if kind in ("payload", "external_wrench") else None
            try:
                return yardstick.scaled(effect, size), yardstick
            except Refused:
                continue
    raise AssertionError(f"{kind} of size {size} at no joint")


def of_each_effect() -> list[Any]:
    """Return ids; what acts as another one does is slow."""
    rest = sorted(set(EFFECTS) - {"backlash", "joint_elasticity", *QUICK})
    return slow_but(QUICK, (*QUICK, *rest))


@pytest.mark.parametrize("kind", of_each_effect())
def test_simulation_adds_the_torque_that_numpy_foretells_with_the_size_told(bench: Bench, kind: str) -> None:
    effect, yardstick = drawn(bench, kind, 0.06)
    assert yardstick.largest(effect, yardstick.of(effect).left) == pytest.approx(0.06, rel=0.03)
    if kind == "actuator_lag":
        bench = Bench(bench.robot, 3, pace=14.0)
    size, wrong = added_by(bench, effect)
    # The lag of half a step differs; and a command that crosses a dead zone takes its time, where numpy's jumps.
    assert wrong < (0.3 if kind == "torque_dead_zone" else 0.1) * size
    for _ in range(3):
        # Where friction sticks it is larger than along the set-point: corrected, as cases are.
        if abs(size / 0.06 - 1.0) > 0.2:
            effect = effect.of_strength(effect.strength * 0.06 / size)
            size, _ = added_by(bench, effect)
    assert size == pytest.approx(0.06, rel=0.2)


def added_by(bench: Bench, effect: Effect) -> tuple[float, float]:
    """Simulate; return the size of what is recorded over the rigid body, and of what numpy's torque leaves of it."""
    _, x, added = bench.run([effect])
    there = Yardstick([x], [x.load + added])
    left = (added, added - effect.torque(x))
    size, wrong = (there.size([e], effect.beside_friction, effect.window).left for e in left)
    return there.largest(effect, size), there.largest(effect, wrong)


PENDULUM = """<robot name="pendulum"><link name="base"/><link name="rod_link"><inertial><origin xyz="0 0 -0.3"/>
<mass value="2"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.001"/></inertial></link>
<joint name="rod" type="revolute"><parent link="base"/><child link="rod_link"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="3" effort="100"/></joint></robot>"""


@pytest.mark.parametrize(("kind", "strength"), [("joint_elasticity", 1 / 150.0), ("backlash", 0.03)])
def test_two_masses_move_as_an_integrator_of_scipy_moves_them(kind: str, strength: float) -> None:
    bench = Bench(Robot("pendulum", PENDULUM), 2, pace=18.0)
    effect = EFFECTS[kind].draw(bench.rng, bench.x, 0).of_strength(strength)
    run, _, _ = bench.run([effect])
    half = 0.0 if kind == "joint_elasticity" else 0.5 * strength
    inertia, weight = 0.02 + 2 * 0.3**2, 2 * 0.3 * 9.81

    def slope(t: float, state: np.ndarray) -> list[float]:
        theta, omega, q, qd = state
        gap = theta - q
        wound = np.sign(gap) * max(abs(gap) - half, 0.0)
        spring = effect.stiffness * wound + (effect.damping * (omega - qd) if wound else 0.0)
        command = run.command[min(int(t / STEP), len(run.t) - 1), 0]
        return [omega, (command - spring) / effect.inertia, qd, (spring - weight * np.sin(q)) / inertia]

    load = bench.x.load[:1, 0]
    start = [
        bench.path.q[0, 0] + effect.yielding(load)[0],
        bench.path.qd[0, 0],
        bench.path.q[0, 0],
        bench.path.qd[0, 0],
    ]
    seconds = 1.5
    solved = solve_ivp(slope, (0.0, seconds), start, max_step=STEP, rtol=1e-6, t_eval=run.t[run.t < seconds])
    behind = np.abs(run.q[: len(solved.t), 0] - solved.y[2]).max()
    assert behind > 0.012
    assert np.abs(run.q[: len(solved.t), 0] - solved.y[0]).max() < 0.1 * behind


def test_background_friction_is_coulomb_and_viscous_torque(bench: Bench) -> None:
    background = Background.draw(np.random.default_rng(8), bench.x)
    _, x, left = bench.run([], background)
    moving = np.abs(x.qd) > 0.1
    n = bench.robot.n
    assert np.abs(left[moving]).max() < 0.02 * np.abs(x.load).max()
    assert len(background.parts()) == 2 * n
    assert np.allclose(sum(part.torque(x) for part in background.parts()), background.torque(x))


@pytest.mark.parametrize("kind", ["gain_of_all_torques", "encoder_offset_of_last_joint", "payload_always_there"])
def test_absorbed_effects_leave_nothing_beside_the_rigid_body(bench: Bench, kind: str) -> None:
    yardstick = Yardstick([bench.x], [bench.x.load])
    effect = absorbed_effect(np.random.default_rng(1), kind, 0.04, yardstick, None)
    size = yardstick.of(effect)
    assert size.raw.max() > 0.03
    assert yardstick.largest(effect, size.left) < 1e-4


def test_size_is_what_an_ordinary_regression_leaves(bench: Bench) -> None:
    effect = EFFECTS["joint_coupling"].draw(np.random.default_rng(2), bench.x, 1)
    x = bench.x
    yardstick = Yardstick([x], [x.load])
    Y = x.robot.regressor(x.q, x.qd, x.qdd).reshape(-1, 10 * x.robot.n)
    signs, speeds = (np.einsum("tj,jk->tjk", v, np.eye(x.robot.n)) for v in (np.sign(x.qd), x.qd))
    A = np.hstack([Y, signs.reshape(len(Y), -1), speeds.reshape(len(Y), -1)])
    weights = np.tile(1 / np.sqrt((x.load**2).mean(0)), len(x.t))
    e = effect.torque(x).ravel() * weights
    left = e - (A * weights[:, None]) @ np.linalg.lstsq(A * weights[:, None], e, rcond=1e-10)[0]
    expected_size = np.sqrt((left.reshape(x.q.shape)[:, 1] ** 2).mean())
    assert yardstick.of(effect).left[1] == pytest.approx(expected_size, rel=0.1)


def test_an_implausible_strength_is_refused(bench: Bench) -> None:
    effect = EFFECTS["encoder_offset"].draw(np.random.default_rng(0), bench.x, 1)
    with pytest.raises(Refused, match="encoder_offset"):
        Yardstick([bench.x], [bench.x.load]).scaled(effect, 3.0)


def test_sets_share_no_robot() -> None:
    assert not set(PUBLIC["development"]) & set(PUBLIC["final"])
    assert random_robot("development", 1).urdf != random_robot("final", 1).urdf


def test_plans_let_every_effect_meet_every_size() -> None:
    for tier, kinds in (("clean", NAMED), ("outside", OUTSIDE), ("absorbed", tiers.ABSORBED)):
        plans = [tiers.plan(tier, index, 0, 1) for index in range(4 * len(kinds))]
        assert {(p.kinds[0], p.sizes[0]) for p in plans} == {(kind, size) for kind in kinds for size in tiers.SIZES}
    counts = [len(tiers.plan("field", index, 0, 1).kinds) for index in range(200)]
    assert set(counts) == {1, 2, 3, 4}
    for index in range(200):
        kinds = tiers.plan("field", index, 0, 1).kinds
        assert len(set(kinds)) == len(kinds)
        assert sum(NAMED[kind].whole_robot for kind in kinds) <= 1
    assert all(tiers.plan("null", index, 0, 1).kinds == () for index in range(20))


def test_same_seed_same_bytes_and_no_truth_in_the_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for length in ("FIT_S", "HALVES_S", "HOLDOUT_S"):
        monkeypatch.setattr(cases, length, 3.0)
    for folder in ("one", "two"):
        write_case(tmp_path / folder, "development", "null", 1, 5)
    one, two = (sorted(p for p in (tmp_path / folder).rglob("*") if p.is_file()) for folder in ("one", "two"))
    assert [p.read_bytes() for p in one] == [p.read_bytes() for p in two]
    assert [p.relative_to(tmp_path / "one") for p in one] == [p.relative_to(tmp_path / "two") for p in two]
    (case,) = (tmp_path / "one" / "cases").iterdir()
    assert {p.name for p in case.iterdir()} <= {"robot.urdf", "fit_1.parquet", "fit_2.parquet", "holdout.parquet"}
    truth = json.loads((tmp_path / "one" / "truth" / f"{case.name}.json").read_text())
    assert truth["effects"] == []
    assert truth["expected"] == "nothing"
    columns = set(pq.read_table(case / "fit_1.parquet").column_names)
    assert {"t"} | {f"{s}_{j}" for s in ("q", "tau") for j in truth["robot"]["joints"]} <= columns
    text = (case / "robot.urdf").read_text()
    assert all(str(values[0]) not in text for values in truth["inertials"].values())


@pytest.mark.slow
@pytest.mark.parametrize("tier", ["clean", "field", "absorbed", "outside"])
def test_cases_have_the_effects_and_sizes_of_their_plan(tier: str) -> None:
    for index in range(3):
        truth = make_case("development", tier, index, 11).truth
        wanted = tiers.plan(tier, index, 11, 0)
        assert len(truth["effects"]) == len(wanted.kinds)
        for effect in truth["effects"]:
            assert tier == "absorbed" or effect["size"] == pytest.approx(effect["target_size"], rel=0.45)
        assert (len(truth["background"]) == 0) == (tier == "clean")
