"""The raw tier: Pinocchio's inverse dynamics against the simulation, sizes, sets, and the scorer of rankings."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from concealed.raw import bodies, cases, classes, draws, rank, score
from concealed.raw.arms import OWN, PUBLIC, own_arm, public_arm, with_wrong_inertials
from concealed.raw.laws import Effect
from concealed.raw.motion import draw_way
from concealed.raw.plant import STEP, Controller, simulate
from concealed.raw.sensing import NOISE, Drives, Sensors, recording
from concealed.robots import Robot

SECONDS = 2.5


class Bench:
    """An arm on a short motion."""

    def __init__(self, seed: int = 5) -> None:
        rng = np.random.default_rng(seed)
        self.robot = own_arm(rng, "parallel", OWN["development"]["parallel"])
        self.way = draw_way(rng, self.robot, SECONDS, 1 / STEP)
        self.friction, self.x = cases._friction(rng, self.robot, self.way)
        urdf = with_wrong_inertials(rng, self.robot, 0.2)
        stiffness = np.sqrt(np.mean(self.x.supplied**2, axis=0)) / 0.02
        self.controller = Controller(urdf, 15.0, stiffness, 0.7)

    def run(self, effect: Effect, size: float = 0.08):
        effect = cases._of_size(effect, self.robot, self.x, size)
        return cases._simulated(self.robot, self.friction, effect, self.way, self.controller, size)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


# One of each way to act: level of friction, push, hidden state, MuJoCo's model, force, sensor, encoder, drive.
@pytest.mark.parametrize(
    ("kind", "tolerance"),
    [("quadratic_drag", 1e-9), ("joint_coupling", 1e-9), ("presliding_hysteresis", 2e-2), ("payload", 1e-9),
     ("external_wrench", 1e-4), ("torque_scale", 1e-9), ("encoder_offset", 1e-9), ("actuator_lag", 5e-2)],
)  # fmt: skip
def test_torque_is_pinocchios_with_friction_and_the_effect(bench: Bench, kind: str, tolerance: float) -> None:
    # On the elbow, which carries enough; where the effect of a link is, chance says.
    effect = draws.draw_effect(np.random.default_rng(1), kind, bench.robot, bench.x)
    effect = effect if effect.window else replace(effect, joint=2, shape=effect.shape | {"other": 1.0})
    track, effect, _ = bench.run(effect)
    assert effect is not None
    x = cases.sampled(bench.robot, track)
    added = bodies.torque(bench.robot, effect, x)
    told = np.stack([pin.rnea(bench.robot.model, bench.robot.model.createData(), *row).copy()
                     for row in zip(track.q[:: cases.EVERY], x.v, x.a, strict=True)])  # fmt: skip
    left = (track.tau - track.friction)[:: cases.EVERY] - told - added
    assert np.abs(added).max() > 0
    assert np.abs(left[2:-2]).max() < tolerance * np.abs(added).max()


def test_size_is_the_one_asked_for(bench: Bench) -> None:
    effect = Effect("joint_spring", 1, {"rest": float(bench.x.q[:, 1].mean())})
    track, effect, added = bench.run(effect, 0.05)
    raw = track.tau[:: cases.EVERY, 1]
    assert effect is not None
    assert np.sqrt(np.mean(added[:, 1] ** 2) / np.mean(raw**2)) == pytest.approx(0.05, rel=0.1)
    assert not added[:, [0, 2, 3, 4, 5]].any()


def test_motion_stays_in_limits_and_starts_anew_with_each_seed(bench: Bench) -> None:
    low, high, fastest = bench.robot.range()
    ways = [draw_way(np.random.default_rng(seed), bench.robot, 20.0, 500.0) for seed in range(4)]
    for way in ways:
        assert (way.q >= low).all()
        assert (way.q <= high).all()
        assert (np.abs(way.v) <= fastest).all()
        assert np.abs(way.q[-1] - way.q[0]).max() > 1e-3
    assert len({way.q[100, 0] for way in ways}) == 4


def test_sets_share_no_arm() -> None:
    kinds = [{*OWN[of], *PUBLIC[of]} for of in ("development", "final")]
    axes = [{kind.axes for kind in OWN[of].values()} for of in ("development", "final")]
    assert not kinds[0] & kinds[1]
    assert not axes[0] & axes[1]


@pytest.mark.parametrize("of", ["development", "final"])
def test_arms_have_possible_inertials_that_are_told_wrong(of: str) -> None:
    rng = np.random.default_rng(0)
    arms = [own_arm(rng, name, kind) for name, kind in OWN[of].items()]
    for arm in [*arms, *(public_arm(name, *where) for name, where in PUBLIC[of].items())]:
        assert arm.n in (6, 7)
        told = with_wrong_inertials(rng, arm, 0.2)
        off = np.array([b.mass / a.mass for a, b in zip(arm.model.inertias[1:], told.model.inertias[1:], strict=True)])
        assert 0.05 < np.std(np.log(off)) < 0.5
        for body in (*arm.model.inertias[1:], *told.model.inertias[1:]):
            moments = np.linalg.eigvalsh(body.inertia)
            assert body.mass > 0
            assert moments[0] > 0
            assert moments[2] <= moments[0] + moments[1] + 1e-12


def test_same_seed_makes_the_same_case(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cases, "FIT_S", 2.0)
    monkeypatch.setattr(cases, "HOLDOUT_S", (1.0, 1.5))
    order = [cases.kind_of(k, 7, "development")[0] for k in range(24)]
    assert sorted(map(str, order)) == sorted([*draws.KINDS, *["None"] * draws.NULLS])
    index = order.index("torque_ripple")
    one, two = (cases.make_case("development", index, 7) for _ in range(2))
    assert json.dumps(one.truth) == json.dumps(two.truth)
    assert one.urdf == two.urdf
    assert all(one.recordings[file].equals(two.recordings[file]) for file in one.recordings)
    (true,) = one.truth["effects"]
    assert one.truth["tier"] == "raw"
    assert true["share"] == pytest.approx(0.08, rel=0.1)
    assert 0 < true["remains"] <= 1
    assert cases.make_case("development", order.index(None), 7).truth["effects"] == []


def test_sensors_add_what_they_are_drawn_to_add() -> None:
    rng, t = np.random.default_rng(2), np.arange(3750) / 125
    true = 10.0 * np.sin(t[:, None] * np.array([0.7, 1.3]))
    size = np.sqrt(np.mean(true**2, axis=0))
    sensors = Sensors(size, np.array([0.008, 0.03]), 0.008, True, np.zeros(2))
    noise = (sensors.torque(rng, t, true) - true) / size
    assert np.sqrt(np.mean(noise**2, axis=0)) == pytest.approx(np.full(2, np.hypot(NOISE, 0.008)), rel=0.15)
    table = recording(["a", "b"], t, true, "tau", true)
    ticks = table["q_a"].to_numpy() / (2 * np.pi / 2**15)
    assert np.abs(ticks - np.round(ticks)).max() < 1e-6
    assert table.column_names == ["t", "q_a", "q_b", "tau_a", "tau_b"]


def test_drives_make_the_torque_of_their_late_set_points() -> None:
    t = np.arange(1250)[:, None] / 125
    q, qd, tau = np.sin(t * [0.7, 1.3]), np.cos(t * [0.7, 1.3]) * [0.7, 1.3], 4.0 * np.cos(t * [1.1, 0.4])
    drives = Drives.draw(np.random.default_rng(3), tau)
    late = np.roll(drives.set_points(q, qd, tau), drives.delay, axis=0)
    inside = slice(drives.delay, None)
    np.testing.assert_allclose((drives.kp * (late - q) - drives.kd * qd)[inside], tau[inside], atol=1e-10)
    stated = yaml.safe_load(drives.mapping(["a", "b"]))
    assert stated["set_point_delay"] == pytest.approx(drives.delay / 125)
    assert [stated["joints"][j]["drive"]["kp"] for j in "ab"] == pytest.approx(drives.kp, rel=1e-5)


def test_class_holds_what_is_the_same_and_not_what_differs(bench: Bench) -> None:
    x, n = bench.x, bench.robot.n

    def names(effect: Effect) -> tuple[set[str], float]:
        tau = bodies.torque(bench.robot, effect, x)
        size = np.sqrt(np.mean(x.supplied**2, axis=0))
        seen = classes.look(bench.robot, x, tau, size, np.full(n, 0.02), effect)
        places = [], [bench.robot.joints[2]], list(bench.robot.joints)
        return {same["effect"] for same in seen.same if same["joints"] in places}, seen.remains

    same, remains = names(Effect("time_delay", -1, {"sign": 1.0}, 0.005))
    assert "actuator_lag" in same
    assert remains > 0.1
    same, remains = names(Effect("torque_ripple", 2, {"order": 40.0, "phase": 0.3}))
    assert not same & {"joint_spring", "one_sided_spring", "rotor_inertia", "torque_scale"}
    assert remains > 0.5
    # A rotor on a first axis that is vertical is the link's own inertia.
    assert names(Effect("rotor_inertia", 0))[1] < 1e-6


@dataclass(frozen=True)
class Hypothesis:
    effect: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    log_evidence: float
    parameters: dict[str, float] = field(default_factory=dict)


class Fabricated:
    """A ranking that knows two names."""

    first = (Hypothesis("one_sided_spring", ("a",), (), 25.0), Hypothesis("joint_spring", ("a",), (), 24.0),
             Hypothesis("base_tilt", (), (), float("-inf")))  # fmt: skip
    last = ()

    def __init__(self) -> None:
        self.asked: list[dict[str, Any]] = []

    def evidence_of(self, **true: Any) -> float:
        assert true == {"effect": "joint_spring", "joints": ("a",), "links": (),
                        "shape": {"rest_position": 0.1}, "window": None}  # fmt: skip
        return 24.5


def _truth(name: str, effects: list[dict[str, Any]]) -> dict[str, Any]:
    return {"id": name, "robot": {"name": "arm", "joints": ["a", "b"]}, "effects": effects}


SPRING = {
    "effect": "joint_spring", "joints": ["a"], "links": [], "other": None, "share": 0.08, "remains": 0.2, "nats": 30.0,
    "parameters": {"stiffness": 3.0, "rest_position": 0.1}, "where": {"recordings": None, "time_s": None},
    "indistinguishable": [{"effect": "one_sided_spring", "joints": ["a"], "links": []}],
}  # fmt: skip


def test_rankings_are_written_and_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, effects in (("case", [SPRING]), ("null", [])):
        (tmp_path / "set" / "cases" / name).mkdir(parents=True)
        (tmp_path / "set" / "truth").mkdir(exist_ok=True)
        (tmp_path / "set" / "truth" / f"{name}.json").write_text(json.dumps(_truth(name, effects)))
    rank.rank_folder(tmp_path / "set", tmp_path / "out", 1, {}, lambda urdf, files: Fabricated())
    result = json.loads((tmp_path / "out" / "case.json").read_text())
    assert result["oracle"] == [24.5]
    assert result["first"][2] == {
        "effect": "base_tilt",
        "joints": [],
        "links": [],
        "log_evidence": None,
        "parameters": {},
    }
    one = score.score_case(_truth("case", [SPRING]), result)
    assert (one.exact, one.in_class, one.at_place, one.evidence, one.named) == (2, 1, 2, 24.0, True)
    capsys.readouterr()
    score.main([str(tmp_path / "out"), str(tmp_path / "set")])
    text = capsys.readouterr().out
    assert "1 of 1" in text
    assert "| greatest evidence on a null | 25.0 |" in text


def test_a_truth_behind_a_stranger_is_not_named() -> None:
    ahead = {"effect": "torque_scale", "joints": ["a"], "links": [], "log_evidence": 60.0, "parameters": {}}
    elsewhere = ahead | {"joints": ["b"]}
    own = ahead | {"effect": "joint_spring", "log_evidence": 20.0}
    truth, more = _truth("case", [SPRING]), {"seconds": 1.0, "oracle": [22.0], "last": []}
    assert score.score_case(truth, more | {"first": [ahead, own]}).named is False
    assert score.score_case(truth, more | {"first": [elsewhere, own]}).named is True
    assert score.score_case(truth, more | {"first": [own | {"log_evidence": 5.0}]}).named is False
    missing = score.score_case(truth, {"seconds": 1.0, "error": "Refused: no"})
    assert (missing.exact, missing.named, missing.error) == (None, False, "Refused: no")


def test_controller_holds_the_arms_of_the_final_set() -> None:
    rng = np.random.default_rng(9)
    arms: list[Robot] = [own_arm(rng, name, kind) for name, kind in OWN["final"].items()]
    for arm in arms:
        way = draw_way(rng, arm, 1.0, 1 / STEP)
        friction, x = cases._friction(rng, arm, way)
        stiffness = np.sqrt(np.mean(x.supplied**2, axis=0)) / 0.02
        track = simulate(
            arm, friction, None, way, Controller(with_wrong_inertials(rng, arm, 0.2), 15.0, stiffness, 0.7)
        )
        assert np.abs(track.q - way.q).max() < 0.2
