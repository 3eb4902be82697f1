"""Scores of made-up diagnoses that one can tell by hand."""

import math
from typing import Any

import pytest
from concealed.matching import covers, judge, new_findings
from concealed.overlap import end_errors, interval_iou, region_iou
from concealed.score import score_case, score_injected
from concealed.tables import case_figures, must_hold

from torchrbd.effects import known_effects

JOINTS = ["a", "b", "c"]
NOWHERE = {"recordings": None, "time_s": None, "region": None}


def effect(name: str, *joints: str, links: tuple[str, ...] = (), **changed: Any) -> dict[str, Any]:
    """Return an entry of a truth file."""
    entry = {
        "effect": name, "joints": list(joints), "links": list(links), "other": None, "parameters": {},
        "where": NOWHERE, "target_size": 0.08, "in_holdout": True, "depends_on": [], "indistinguishable": [],
    }  # fmt: skip
    return {**entry, **changed}


def truth(*effects: dict[str, Any], tier: str = "field", **changed: Any) -> dict[str, Any]:
    robot = {"name": "arm", "joints": JOINTS, "links": ["la", "lb", "lc"]}
    case = {"id": "1", "tier": tier, "robot": robot, "effects": list(effects), "background": [], "companions": []}
    return {**case, **changed}


def finding(name: str, *joints: str, probability: float = 0.95, links: tuple[str, ...] = (), **changed: Any) -> dict:
    """Return a finding of a diagnosis.json."""
    entry = {
        "effect": name, "joints": list(joints), "links": list(links), "probability": probability, "parameters": {},
        "where": NOWHERE, "indistinguishable_from": [], "log_evidence_gain": 50.0,
        "family": known_effects()[name].family if name in known_effects() else "unknown",
    }  # fmt: skip
    return {**entry, **changed}


def diagnosis(*findings: dict, left: tuple[dict, ...] = (), **changed: Any) -> dict[str, Any]:
    return {"findings": list(findings), "unexplained": list(left), **changed}


def left_at(joint: str, *signals: str, **where: Any) -> dict[str, Any]:
    return {"joints": [joint], "depends_on": list(signals), "where": {**NOWHERE, **where}}


def quantity(value: float, std: float, unit: str) -> dict[str, Any]:
    return {"value": value, "std": std, "unit": unit}


BACKGROUND = [
    effect("viscous_friction", "a"), effect("asymmetric_coulomb_friction", "a"),
    effect("viscous_friction", "b"), effect("asymmetric_coulomb_friction", "b"),
]  # fmt: skip


def test_named_exactly_beside_background_and_a_false_one() -> None:
    found = diagnosis(
        finding("torque_ripple", "b"),
        finding("viscous_friction", "a", probability=0.9),
        finding("joint_spring", "c", probability=0.7),
    )
    score = score_case(truth(effect("torque_ripple", "b"), background=BACKGROUND), found, 3.0)
    (one,) = score.effects
    assert (one.exact, one.in_class, one.joint, one.probability) == (True, True, True, 0.95)
    assert score.judgements == ((0.95, True, 50.0), (0.9, True, None), (0.7, False, 50.0))
    assert score.false == (("joint_spring", "c", 0.7),)
    assert (score.alarms, score.n_joints, score.seconds) == (1, 3, 3.0)
    # Friction of joint a was asked for, that of the concealed effect's own joint was not; Coulomb friction is missing.
    assert score.background == (True, False)


@pytest.mark.parametrize(
    ("found", "true"),
    [
        (
            finding("torque_offset", "b", indistinguishable_from=[{"effect": "joint_spring", "joints": ["b"]}]),
            effect("joint_spring", "b"),
        ),
        (
            finding("torque_offset", "b"),
            effect("joint_spring", "b", indistinguishable=[{"effect": "torque_offset", "joints": ["b"], "links": []}]),
        ),
        (
            finding("payload", links=("lb",)),
            effect("rotor_inertia", "a", indistinguishable=[{"effect": "payload", "joints": [], "links": ["lb"]}]),
        ),
        (finding("time_delay", "b"), effect("time_delay", *JOINTS)),
    ],
)
def test_in_class_is_not_exact(found: dict, true: dict) -> None:
    score = score_case(truth(true), diagnosis(found), 1.0)
    assert (score.effects[0].exact, score.effects[0].in_class, score.false) == (False, True, ())


@pytest.mark.parametrize(
    ("found", "true"),
    [
        (finding("joint_spring", "a"), effect("joint_spring", "b")),
        (finding("torque_offset", "b"), effect("joint_spring", "b")),
        (finding("payload", links=("la",)), effect("payload", links=("lb",))),
        (finding("joint_coupling", "a", "c"), effect("joint_coupling", "a")),
        (
            finding("torque_offset", "b", indistinguishable_from=[{"effect": "joint_spring", "joints": ["a"]}]),
            effect("joint_spring", "b"),
        ),
    ],
)
def test_wrong_place_or_name_is_false(found: dict, true: dict) -> None:
    score = score_case(truth(true), diagnosis(found), 1.0)
    assert not score.effects[0].in_class
    assert len(score.false) == 1


def test_effect_of_all_joints_may_be_named_without_any() -> None:
    score = score_case(truth(effect("time_delay", *JOINTS)), diagnosis(finding("time_delay")), 1.0)
    assert score.effects[0].exact


def test_one_finding_names_one_effect() -> None:
    twice = [finding("joint_spring", "b", probability=p) for p in (0.6, 0.9)]
    judged = judge(twice, truth(effect("joint_spring", "b")))
    assert [j.kind for j in judged] == ["false", "exact"]


def test_exact_goes_before_a_surer_one_in_class() -> None:
    alike = [{"effect": "torque_offset", "joints": ["b"], "links": []}]
    judged = judge(
        [finding("torque_offset", "b", probability=0.99), finding("joint_spring", "b", probability=0.5)],
        truth(effect("joint_spring", "b", indistinguishable=alike)),
    )
    assert [j.kind for j in judged] == ["false", "exact"]


def test_friction_of_the_background_may_be_told_in_parts_or_contained() -> None:
    case = truth(background=BACKGROUND)
    parts = [finding("coulomb_friction", "a"), finding("torque_offset", "a")]
    assert [j.kind for j in judge(parts, case)] == ["background", "background"]
    assert covers(parts, BACKGROUND[1], JOINTS)
    assert not covers(parts[1:], BACKGROUND[1], JOINTS)
    richer = [finding("stribeck_friction", "a")]
    assert [j.kind for j in judge(richer, case)] == ["false"]
    assert covers(richer, BACKGROUND[1], JOINTS)


def test_companions_are_neither_right_nor_false() -> None:
    case = truth(effect("joint_elasticity", "b"), companions=[effect("rotor_inertia", "b")])
    score = score_case(case, diagnosis(finding("rotor_inertia", "b")), 1.0)
    assert (score.judgements, score.false) == ((), ())


def test_silence_is_right_where_other_inertials_do_the_same() -> None:
    true = effect("rotor_inertia", "a", indistinguishable=[{"effect": "rigid_body", "joints": [], "links": []}])
    case = truth(true, tier="absorbed")
    assert score_case(case, diagnosis(), 1.0).effects[0].in_class
    assert not score_case(case, diagnosis(finding("joint_spring", "a")), 1.0).effects[0].in_class
    assert not score_case(case, {"error": "RecordingError: too short"}, 1.0).effects[0].in_class


def test_alarms_on_nulls_count_joints_once() -> None:
    found = diagnosis(finding("joint_spring", "a"), left=(left_at("a", "q_a"), left_at("c", "qd_b")))
    assert score_case(truth(tier="null"), found, 1.0).alarms == 2
    # What is left at a concealed effect's own joint is no alarm.
    assert score_case(truth(effect("torque_bump", "c")), found, 1.0).alarms == 1


def test_locations_count_before_anything_is_named() -> None:
    where = {"recordings": ["fit_1.parquet"], "time_s": [[10.0, 20.0]], "region": None}
    load = effect("payload", links=("lb",), where=where, size_by_joint={"a": 0.02, "b": 0.08, "c": 0.0})
    told = {"model": "rigid_body", "joints": ["b", "c"], "links": ["lb"], "depends_on": ["t"]}
    located = {**told, "where": {**NOWHERE, "time_s": [[10.1, 20.0]]}}
    score = score_case(truth(load), diagnosis(locations=[located, {**located, "model": "extended", "links": []}]), 1.0)
    (one,) = score.effects
    assert (one.link, one.in_class, one.end_errors_s) == (True, False, pytest.approx((0.1, 0.0)))
    # The payload is felt at a and b.
    assert score.alarms == 1
    assert score_case(truth(tier="null"), diagnosis(locations=[located]), 1.0).alarms == 2


def test_unexplained_needs_joint_and_first_variable() -> None:
    case = truth(effect("velocity_product", "b", depends_on=["qd_a", "qd_b"]), tier="outside")
    for signals, right in ((("qd_b", "q_c"), True), (("q_c", "qd_b"), False)):
        assert score_case(case, diagnosis(left=(left_at("b", *signals),)), 1.0).effects[0].unexplained is right
    other = score_case(case, diagnosis(left=(left_at("c", "qd_b"),)), 1.0)
    assert (other.effects[0].unexplained, other.effects[0].joint, other.alarms) == (False, False, 1)


def test_parameters_and_their_intervals() -> None:
    true = effect("stribeck_friction", "b", parameters={"coulomb": 1.0, "static": 2.0, "stribeck_speed": 0.1})
    told = {
        "coulomb": quantity(1.1, 0.06, "N m"),
        "static": quantity(2.3, 0.1, "N m"),
        "stribeck_speed": quantity(0.12, 0.0, "rad/s"),
    }
    one = score_case(truth(true), diagnosis(finding("stribeck_friction", "b", parameters=told)), 1.0).effects[0]
    # Both levels relative to the larger one; a standard deviation of zero is no interval.
    assert one.errors == pytest.approx((0.05, 0.15))
    assert one.shape_errors == pytest.approx((0.2,))
    assert one.covered == (True, False)


@pytest.mark.parametrize(
    ("name", "true", "told", "errors", "shapes"),
    [
        ("torque_scale", {"gain": 1.05}, {"gain": quantity(1.06, 0.0, "1")}, [0.2], []),
        ("torque_ripple", {"amplitude": 1.0, "order": 8.0, "phase": 3.1},
         {"phase": quantity(-3.1, 0.0, "rad"), "order": quantity(8.4, 0.0, "1/rad")}, [],
         [(2 * math.pi - 6.2) / 3.1, 0.05]),
        ("joint_spring", {"stiffness": 2.0, "rest_position": 0.0},
         {"stiffness": quantity(2.2, 0.0, "N m/rad"), "rest_position": quantity(0.05, 0.0, "rad")}, [0.1], [0.05]),
        ("external_wrench", {"force_x": 0.0, "force_z": 10.0},
         {"force_x": quantity(1.0, 0.0, "N"), "force_z": quantity(9.5, 0.0, "N")}, [0.1, 0.05], []),
        ("encoder_offset", {"offset": 0.02}, {"offset": quantity(0.03, 0.0, "rad")}, [0.5], []),
    ],
)  # fmt: skip
def test_errors_are_relative_to_what_matters(name: str, true: dict, told: dict, errors: list, shapes: list) -> None:
    found = diagnosis(finding(name, "b", parameters=told))
    one = score_case(truth(effect(name, "b", parameters=true)), found, 1.0).effects[0]
    assert one.errors == pytest.approx(errors)
    assert one.shape_errors == pytest.approx(shapes)


def test_gain_share_is_of_the_concealed_joint() -> None:
    case = truth(effect("joint_spring", "b"))
    fit = {"rigid_body": {"nmse": {"a": 0.9, "b": 0.5}}, "extended": {"nmse": {"a": 0.9, "b": 0.2}}}
    found = diagnosis(finding("joint_spring", "b"), fit=fit)
    assert score_case(case, found, 1.0, {"a": 0.1, "b": 0.1}).gain_share == pytest.approx(0.75)
    assert score_case(case, found, 1.0, {"a": 0.1, "b": 0.499}).gain_share is None
    assert score_case(case, found, 1.0).gain_share is None


def test_overlaps_of_times() -> None:
    assert interval_iou([(0, 4)], [(2, 6)]) == pytest.approx(1 / 3)
    assert interval_iou([(0, 1), (2, 3)], [(0, 3)]) == pytest.approx(2 / 3)
    assert interval_iou([(0, 1)], []) == 0.0
    assert end_errors([(0, 4), (10, 12)], [(0.5, 3.8)]) == pytest.approx((0.5, 0.2, math.inf, math.inf))


def test_overlap_of_regions_wants_the_signal() -> None:
    true = [{"signal": "q_b", "low": 0.0, "high": 2.0}]
    assert region_iou(true, [{"signal": "q_b", "low": 1.0, "high": 2.0}]) == pytest.approx(0.5)
    assert region_iou(true, [{"signal": "q_a", "low": 0.0, "high": 2.0}]) == 0.0
    half = [{"signal": "q_b", "low": 1.0, "high": None}]
    assert region_iou(half, [{"signal": "q_b", "low": 1.5, "high": 2.0}]) == pytest.approx(0.5)


def test_times_of_what_is_left_count_where_nothing_is_named() -> None:
    where = {"recordings": ["fit_1.parquet"], "time_s": [[10.0, 20.0]], "region": None}
    case = truth(effect("external_wrench", links=("lb",), where=where, joints=["b"]))
    left = left_at("b", "t", time_s=[[10.2, 19.0]], recordings=["fit_1.parquet"])
    one = score_case(case, diagnosis(left=(left,)), 1.0).effects[0]
    assert one.end_errors_s == pytest.approx((0.2, 1.0))
    assert one.window_iou == pytest.approx(0.88)
    assert (one.recordings, one.in_class) == (True, False)
    nothing = score_case(case, diagnosis(), 1.0).effects[0]
    assert nothing.end_errors_s == (math.inf, math.inf)
    assert (nothing.window_iou, nothing.recordings) == (0.0, False)


def test_how_large_held_out_time_has_it_is_judged_where_all_of_it_is_right() -> None:
    there = {"held_out_ratio": {"value": 1.1, "low": 0.9, "high": 1.3}}
    right, wrong = (diagnosis(finding(name, "b")) | there for name in ("torque_ripple", "joint_spring"))
    scores = [score_case(truth(effect("torque_ripple", "b")), told, 1.0) for told in (right, wrong)]
    assert [(s.slope, s.slope_covers) for s in scores] == [(1.1, True), (None, None)]
    off = score_case(
        truth(effect("torque_ripple", "b")), right | {"held_out_ratio": {**there["held_out_ratio"], "low": 1.05}}, 1.0
    )
    assert case_figures([*scores, off])["its interval holds one"].value == 0.5


def test_injected_counts_what_is_new() -> None:
    case = truth(effect("torque_ripple", "b"), tier="injected", baseline="0")
    left = (left_at("c", "q_c"), left_at("d"))
    before = diagnosis(finding("stribeck_friction", "a"), left=left)
    after = diagnosis(
        finding("torque_ripple", "b"), finding("coulomb_friction", "a"), finding("joint_spring", "c"), left=left,
    )  # fmt: skip
    score = score_injected(case, after, before, 1.0)
    assert score is not None
    assert score.effects[0].exact
    assert [name for name, *_ in score.false] == ["joint_spring"]
    assert score.told is None
    for told, seen in ((diagnosis(finding("torque_ripple", "b")), True), (diagnosis(), False)):
        again = score_injected(case, after, before, 1.0, told)
        assert again is not None
        assert again.told == seen
        (row,) = (figure for words, figure, *_ in must_hold([again]) if words.startswith("injected, 8 %, where"))
        assert row.n == seen
    assert [f["effect"] for f in new_findings(after["findings"], before["findings"])] == [
        "torque_ripple", "joint_spring",
    ]  # fmt: skip


def test_what_contains_the_friction_that_was_there_is_new_if_it_names_the_injected() -> None:
    case = truth(effect("stribeck_friction", "b"), tier="injected", baseline="0")
    before = diagnosis(finding("coulomb_friction", "a"), finding("coulomb_friction", "b"))
    after = diagnosis(finding("stribeck_friction", "b"), finding("stribeck_friction", "a"))
    score = score_injected(case, after, before, 1.0)
    assert score is not None
    assert score.effects[0].exact
    assert not score.false


@pytest.mark.parametrize(("told", "near"), [("load_dependent_friction", True), ("joint_spring", False)])
def test_injected_may_be_found_by_its_family(told: str, near: bool) -> None:
    case = truth(effect("stribeck_friction", "b"), tier="injected", baseline="0")
    score = score_injected(case, diagnosis(finding(told, "b"), finding(told, "a")), diagnosis(), 1.0)
    assert score is not None
    assert (score.effects[0].in_class, score.effects[0].family) == (False, near)


def test_injected_is_not_judged_if_it_was_there_before() -> None:
    case = truth(effect("torque_ripple", "b"), tier="injected", baseline="0")
    assert score_injected(case, diagnosis(), diagnosis(finding("torque_ripple", "b")), 1.0) is None
