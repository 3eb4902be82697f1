"""What changed between two diagnoses: probabilities, statements, files, and the physics of a load."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from robot.random_robots import random_urdf
from scipy.stats import norm
from simulated import Motion, joint_names, record

import torchrbd
from torchrbd.comparison.inertia import inertial_differences, load_like
from torchrbd.comparison.reading import Inertia, rebuilt, side_of
from torchrbd.comparison.results import CHANGE, NEGLIGIBLE, Change, Comparison, probability_of_change
from torchrbd.diagnosis.results import Alternative, Curve, DetectionLimit, Finding, Quantity, Region, Unexplained, Where
from torchrbd.export import write_changes
from torchrbd.parameters import base_parameters
from torchrbd.report import write_changes_report
from torchrbd.robot import RobotModel

JOINTS = ("joint1", "joint2")


def finding(effect: str, joint: str = "joint2", /, **parameters: tuple[float, float]) -> Finding:
    quantities = {name: Quantity(value, std, "N m") for name, (value, std) in parameters.items()}
    return Finding(effect, (joint,), (), 0.999, 90.0, quantities, Where(), (), {joint: 0.1}, {joint: 0.01})


def limit(
    effect: str, parameter: str, value: float, std: float, joint: str = "joint2", none: float = 0.0
) -> DetectionLimit:
    return DetectionLimit(effect, (joint,), (), (), parameter, value, std, none, "N m", {})


def coulomb(value: float, std: float = 0.01, **other: float) -> Finding:
    return replace(finding("coulomb_friction", coulomb=(value, std)), **other)


def folder(
    tmp_path: Path,
    name: str,
    findings: tuple[Finding, ...] = (),
    detection_limits: tuple[DetectionLimit, ...] = (),
    unexplained: tuple[Unexplained, ...] = (),
    **other: object,
) -> Path:
    """Write a diagnosis.json as other tools would find it."""
    content = {
        "schema": 1, "robot": "arm", "joints": list(JOINTS), "recordings": [f"{name}.csv"], "cutoff_hz": 5.0,
        "findings": [asdict(f) for f in findings], "detection_limits": [asdict(x) for x in detection_limits],
        "unexplained": [asdict(u) for u in unexplained], "simulated": [],
    }  # fmt: skip
    (tmp_path / name).mkdir()
    (tmp_path / name / "diagnosis.json").write_text(json.dumps(content | other))
    return tmp_path / name


def compared(tmp_path: Path, before: dict, after: dict) -> Comparison:
    return torchrbd.compare(folder(tmp_path, "before", **before), folder(tmp_path, "after", **after))


def only(result: Comparison) -> Change:
    (change,) = result.changes
    return change


@pytest.mark.parametrize(
    ("d", "std", "size"), [(0.0, 0.05, 1.0), (0.2, 0.03, 1.2), (-3.0, 1.0, 10.0), (0.02, 1e-3, 0.5)]
)
def test_probability_is_bayes_rule(d: float, std: float, size: float) -> None:
    """Against the mixture integrated over the true difference."""
    true = np.linspace(-4 * size, 4 * size, 400_001)
    seen = norm.pdf(d, true, std)
    same, changed = (np.trapezoid(seen * norm.pdf(true, 0.0, part * size), true) for part in (NEGLIGIBLE, CHANGE))
    assert probability_of_change(d, std, size) == pytest.approx(changed / (same + changed), rel=1e-6)


def test_probability_at_its_ends() -> None:
    assert probability_of_change(0.3, 1e3, 1.0) == pytest.approx(0.5, abs=1e-3)
    assert probability_of_change(0.0, 1e-3, 1.0) < 0.1
    assert probability_of_change(0.5, 1e-3, 1.0) > 0.999
    assert probability_of_change(0.015, 1e-3, 1.0) < 0.2
    assert math.isnan(probability_of_change(0.1, math.nan, 1.0))
    assert probability_of_change(0.2, 0.05, 1.0, among=100) < probability_of_change(0.2, 0.05, 1.0)


@pytest.mark.parametrize("std", [0.003, 0.01, 0.05, 0.2])
def test_honest_values_of_one_robot_seldom_change(std: float) -> None:
    rng = np.random.default_rng(1)
    d = std * (rng.standard_normal(4000) - rng.standard_normal(4000))
    p = np.array([probability_of_change(x, math.sqrt(2) * std, 1.0) for x in d])
    assert np.mean(p > 0.95) < 0.01
    grown = np.array([probability_of_change(x + 0.2, math.sqrt(2) * 0.02, 1.2) for x in d / std * 0.02])
    assert np.mean(grown > 0.95) > 0.95


def test_grown_friction_is_said_with_units_and_certainty(tmp_path: Path) -> None:
    result = compared(tmp_path, {"findings": (coulomb(1.2, 0.02),)}, {"findings": (coulomb(1.9, 0.02),)})
    change = only(result)
    assert (change.kind, change.verdict, change.found) == ("finding", "changed", "both")
    assert change.statement == (
        "Coulomb friction of joint2 grew from 1.20 to 1.90 N m (+0.70 ± 0.06); probability > 0.99."
    )
    assert change.parameters["coulomb"].difference == pytest.approx(0.7)
    assert change.parameters["coulomb"].std == pytest.approx(math.hypot(0.02, 0.02))
    assert result.statement.startswith(change.statement)
    assert result.before == str(tmp_path / "before")


def test_what_is_as_it_was_and_what_nobody_can_tell(tmp_path: Path) -> None:
    near, far = finding("torque_offset", "joint1", offset=(1.0, 0.01)), coulomb(1.0, 0.2)
    moved = (finding("torque_offset", "joint1", offset=(1.01, 0.01)), coulomb(1.3, 0.2))
    result = compared(tmp_path, {"findings": (near, far)}, {"findings": moved})
    assert {c.effect: c.verdict for c in result.changes} == {"torque_offset": "unchanged", "coulomb_friction": "open"}
    assert "No change is certain" in result.statement
    assert any("unchanged" in c.statement for c in result.changes)


def test_an_unsure_name_makes_no_sure_change(tmp_path: Path) -> None:
    result = compared(
        tmp_path, {"findings": (coulomb(1.2, probability=0.6),)}, {"findings": (coulomb(1.9, probability=0.6),)}
    )
    assert only(result).verdict == "open"
    assert only(result).probability == pytest.approx(0.5 * (1 + 0.36), abs=1e-3)


@pytest.mark.parametrize(("direction", "words"), [("after", "is new"), ("before", "is gone")])
def test_new_and_gone_are_certain_if_the_other_data_would_have_shown_them(
    direction: str, words: str, tmp_path: Path
) -> None:
    there, not_there = (
        {"findings": (coulomb(1.2, 0.05),)},
        {"detection_limits": (limit("coulomb_friction", "coulomb", 0.02, 0.05),)},
    )
    sides = (not_there, there) if direction == "after" else (there, not_there)
    change = only(compared(tmp_path, *sides))
    assert (change.found, change.verdict) == (direction, "changed")
    assert words in change.statement
    assert "0.02 ± 0.10 N m" in change.statement


@pytest.mark.parametrize(
    ("detection_limits", "words"),
    [
        ((), "does not say which size it could have detected"),
        ((limit("coulomb_friction", "coulomb", 0.1, 2.0),), "The other data could not detect it"),
        ((limit("coulomb_friction", "coulomb", 1.1, 0.2),), "other data"),
        ((limit("coulomb_friction", "coulomb", 3.0, 0.1),), "other data"),
    ],
    ids=["no limit", "loose", "about as large", "larger than what was found"],
)
def test_not_found_is_no_proof_of_absence(
    detection_limits: tuple[DetectionLimit, ...], words: str, tmp_path: Path
) -> None:
    change = only(compared(tmp_path, {"detection_limits": detection_limits}, {"findings": (coulomb(1.2, 0.05),)}))
    assert (change.found, change.verdict) == ("after", "open")
    assert words in change.statement


def test_a_limit_counts_for_its_shape_only(tmp_path: Path) -> None:
    """That no wide bump was there says nothing of a narrow one."""
    found = finding("stribeck_friction", coulomb=(1.2, 0.01), static=(2.0, 0.05), stribeck_speed=(0.2, 0.02))
    for name, speed, verdict in (("near", 0.19, "changed"), ("far", 0.6, "open")):
        (tmp_path / name).mkdir()
        known = replace(limit("stribeck_friction", "static", 1.2, 0.03, none=1.2), shape={"stribeck_speed": speed})
        change = only(compared(tmp_path / name, {"detection_limits": (known,)}, {"findings": (found,)}))
        assert change.verdict == verdict


def test_what_acts_for_a_time_is_of_its_recording(tmp_path: Path) -> None:
    load = replace(finding("payload", mass=(2.0, 0.1)), where=Where(("after.csv",), ((3.0, 8.0),)))
    change = only(
        compared(tmp_path, {"detection_limits": (limit("payload", "mass", 0.0, 0.1),)}, {"findings": (load,)})
    )
    assert change.verdict == "open"
    assert "in a window of time" in change.statement


def test_another_name_is_no_change(tmp_path: Path) -> None:
    spring = finding("joint_spring", stiffness=(3.0, 0.1))
    balance = replace(
        finding("counterbalance", spring_torque=(5.0, 0.1)),
        indistinguishable_from=(Alternative("joint_spring", ("joint2",)),),
    )
    result = compared(tmp_path, {"findings": (spring,)}, {"findings": (balance,)})
    assert [c.verdict for c in result.changes] == ["open", "open"]
    assert all("may be another name for it" in c.statement for c in result.changes)


def test_friction_in_motion_is_compared_where_more_of_it_is_seen(tmp_path: Path) -> None:
    stribeck = finding("stribeck_friction", coulomb=(1.2, 0.01), static=(2.0, 0.05), stribeck_speed=(0.2, 0.02))
    before = {
        "findings": (coulomb(1.2),),
        "detection_limits": (limit("stribeck_friction", "static", 1.21, 0.03, none=1.2),),
    }
    result = compared(tmp_path, before, {"findings": (stribeck,)})
    by_effect = {c.effect: c for c in result.changes}
    assert by_effect["coulomb_friction"].found == "both"
    assert by_effect["coulomb_friction"].verdict != "changed"
    assert by_effect["stribeck_friction"].verdict == "changed"
    uneven = finding("asymmetric_coulomb_friction", coulomb_plus=(1.5, 0.01), coulomb_minus=(0.9, 0.01))
    (tmp_path / "2").mkdir()
    (change,) = compared(tmp_path / "2", {"findings": (coulomb(1.2),)}, {"findings": (uneven,)}).changes
    assert change.parameters["coulomb"].after == Quantity(1.2, pytest.approx(0.5 * math.hypot(0.01, 0.01)), "N m")


def test_a_neighbour_that_one_lacks_widens_the_std(tmp_path: Path) -> None:
    more = finding("viscous_friction", viscous=(0.5, 0.01))
    change = compared(tmp_path, {"findings": (coulomb(1.2), more)}, {"findings": (coulomb(1.25),)}).changes
    (told,) = (c for c in change if c.effect == "coulomb_friction")
    assert told.parameters["coulomb"].std == pytest.approx(4 * math.hypot(0.01, 0.01))


def test_what_has_no_name_is_told_without_certainty(tmp_path: Path) -> None:
    one = Unexplained(("joint1",), ("q_joint1",), Where(), 0.4)
    change = only(compared(tmp_path, {}, {"unexplained": (one,)}))
    assert (change.kind, change.found, change.verdict) == ("unexplained", "after", "open")
    assert math.isnan(change.probability)


def test_files_say_what_was_written(tmp_path: Path) -> None:
    region = Where(("a.csv",), ((1.0, 2.0),), (Region("q_joint1", -0.1, 0.3),))
    curve = Curve("q_joint1", (0.0, 1.0), (2.0, 3.0), (0.1, 0.1))
    whole = replace(
        coulomb(1.2), where=region, curve=curve, indistinguishable_from=(Alternative("payload", (), ("l",)),)
    )
    assert rebuilt(Finding, json.loads(json.dumps(asdict(whole)))) == whole
    assert math.isnan(rebuilt(Quantity, {"value": 1.0, "std": None, "unit": ""}).std)
    side = side_of(folder(tmp_path, "one", findings=(whole,)) / "diagnosis.json", "")
    assert side.findings == (whole,)


def body(urdf: str, rng: np.random.Generator, added: np.ndarray | None = None, std: float = 1e-3) -> Inertia:
    """Return what a diagnosis would say of a robot's inertia: base parameters with correlated errors."""
    robot = RobotModel.from_urdf(urdf)
    base = base_parameters(robot)
    K, pi = base.combination.numpy(), robot.pi.numpy().copy()
    pi += 0.0 if added is None else added
    L = std * (np.eye(len(K)) + 0.3 * np.tril(rng.standard_normal((len(K), len(K))), -1))
    beta = K @ pi + L @ rng.standard_normal(len(K))
    units = ("",) * len(K)
    return Inertia(tuple(robot.parameter_names), K, pi, beta, L @ L.T, np.zeros(len(K)), tuple(base.expressions), units)


@pytest.mark.parametrize(("seed", "mass"), [(1, 0.5), (2, -0.3), (3, 1.0)])
def test_a_load_is_found_on_its_link(seed: int, mass: float) -> None:
    rng = np.random.default_rng(seed)
    urdf = random_urdf(30 + seed, 5, kinds=("revolute",), branching=0.0, massless=0.0)
    c, at, added = rng.uniform(-0.1, 0.1, 3), 3, np.zeros(50)
    I = mass * (c @ c * np.eye(3) - np.outer(c, c))  # noqa: E741
    added[10 * at : 10 * at + 10] = [mass, *(mass * c), I[0, 0], I[0, 1], I[1, 1], I[0, 2], I[1, 2], I[2, 2]]
    before, after = body(urdf, rng), body(urdf, rng, added)
    bodies = RobotModel.from_urdf(urdf).body_names
    load = load_like(before, after, np.repeat(bodies, 10).tolist())
    assert load is not None
    assert bodies[at] in load.links
    assert load.mass == pytest.approx(mass, abs=4 * load.std)
    assert max(d.probability for d in (inertial_differences(before, after) or {}).values()) > 0.99


def test_one_body_twice_has_no_change() -> None:
    rng, urdf = np.random.default_rng(7), random_urdf(40, 5, kinds=("revolute",), branching=0.0, massless=0.0)
    for _ in range(20):
        pair = body(urdf, rng), body(urdf, rng)
        found = inertial_differences(*pair)
        assert found
        assert max(d.probability for d in found.values()) < 0.95
    other = body(random_urdf(41, 5, kinds=("revolute",), branching=0.0, massless=0.0), rng)
    assert inertial_differences(pair[0], other) is None


def test_comparison_is_written(tmp_path: Path) -> None:
    load = replace(finding("payload", mass=(2.0, 0.1)), where=Where(("after.csv",), ((3.0, 8.0),)))
    result = compared(tmp_path, {"findings": (coulomb(1.2),)}, {"findings": (coulomb(1.9), load)})
    write_changes(result, tmp_path / "comparison.json")
    content = json.loads((tmp_path / "comparison.json").read_text())
    assert content["schema"] == 1
    assert [c["verdict"] for c in content["changes"]] == [c.verdict for c in result.changes]
    assert content["changes"][0]["parameters"]["coulomb"]["after"]["value"] == 1.9
    assert content["changes"][-1]["probability"] is None
    write_changes_report(result, tmp_path / "c.html")
    page = (tmp_path / "c.html").read_text()
    assert page.startswith("<!")
    assert "http" not in page
    assert "≠ changed" in page


def test_unusable_diagnoses_are_refused(tmp_path: Path) -> None:
    good = folder(tmp_path, "good", findings=(coulomb(1.2),))
    (tmp_path / "words").mkdir()
    (tmp_path / "words" / "diagnosis.json").write_text("friction")
    (tmp_path / "list.json").write_text("[1]")
    viscous = replace(coulomb(1.0), parameters={"coulomb": Quantity(1.0, 0.1, "N")})
    broken = asdict(coulomb(1.0)) | {"parameters": 3}
    half = folder(tmp_path, "half")
    (half / "parameters.json").write_text("{}")
    for bad, words in (
        (tmp_path / "nowhere", "cannot be read"),
        (tmp_path / "words", "is not JSON"),
        (tmp_path / "list.json", "expected what 'torchrbd diagnose' writes"),
        (folder(tmp_path, "other robot", robot="leg"), "of robot 'leg'; compare diagnoses of one robot"),
        (folder(tmp_path, "other joints", joints=["joint1", "knee"]), "only one has joint2, knee"),
        (folder(tmp_path, "no robot", robot=None, joints=None), "is no diagnosis.json"),
        (folder(tmp_path, "units", findings=(viscous,)), "is in N m before and in N after"),
        (half, "is no parameters.json"),
    ):
        with pytest.raises(torchrbd.InputError, match=words):
            torchrbd.compare(good, bad)
    content = json.loads((good / "diagnosis.json").read_text()) | {"findings": [broken]}
    (good / "diagnosis.json").write_text(json.dumps(content))
    with pytest.raises(torchrbd.InputError, match=r"is no diagnosis.json .*diagnose the recordings again"):
        torchrbd.compare(folder(tmp_path, "sound"), good)


def rubbing(urdf: str, coefficients: np.ndarray):
    def extra(motion: Motion) -> np.ndarray:
        return coefficients * np.sign(motion.qd) + 0.8 * motion.qd

    assert len(coefficients) == len(joint_names(urdf))
    return extra


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(61, 67))
def test_one_robot_twice_and_with_more_friction(seed: int) -> None:
    """Whole diagnoses of other motions: nothing changed is certain, a fifth more friction is."""
    urdf = random_urdf(seed, 3, kinds=("revolute",), branching=0.0, massless=0.0)
    level = np.full(3, 3.0)
    before = torchrbd.diagnose(urdf, record(urdf, seed, extra=rubbing(urdf, level)))
    again = torchrbd.diagnose(urdf, record(urdf, seed + 100, extra=rubbing(urdf, level)))
    assert [c.statement for c in torchrbd.compare(before, again).changes if c.verdict == "changed"] == []
    more = torchrbd.diagnose(urdf, record(urdf, seed + 200, extra=rubbing(urdf, level * [1.0, 1.2, 1.0])))
    changed = [c for c in torchrbd.compare(before, more).changes if c.verdict == "changed"]
    assert [(c.effect, c.joints) for c in changed] == [("coulomb_friction", ("joint2",))]
