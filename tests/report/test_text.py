"""Every sentence of a result: short, in the field's terms, and headlines that hold what is found."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from report.fabricated import diagnosis

from torchrbd.comparison.results import Difference
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.results import (
    OWN_TIME,
    Alternative,
    Elpd,
    Finding,
    HeldOutCheck,
    NextEffect,
    Quantity,
    Ratio,
    Region,
    Unexplained,
    Variant,
    Where,
    strongest_first,
)
from torchrbd.report.text.comparison import signed
from torchrbd.report.text.names import all_or_some, alternatives, guessed, more_values, when
from torchrbd.report.text.numbers import as_many_as_fit, joined, measure, percent, unit, with_unit
from torchrbd.report.text.verdict import headline

JOINTS = tuple(f"joint{k}" for k in range(1, 8))


def finding(effect: str, *joints: str, links: tuple[str, ...] = (), **changes: Any) -> Finding:
    """Return a finding that held-out data confirms at its first joint, or at the first of all."""
    quantities, shown = {"size": Quantity(1.635, 0.004, "N m")}, joints[0] if joints else JOINTS[0]
    plain = Finding(effect, joints, links, 0.99, 50.0, quantities, Where(), (), {shown: 0.5}, {shown: 0.1})
    return replace(plain, **changes)


def result(*findings: Finding, **changes: Any) -> Diagnosis:
    return replace(diagnosis(JOINTS), findings=strongest_first(findings), unexplained=(), **changes)


def head(*findings: Finding, **changes: Any) -> str:
    return headline(result(*findings, **changes))[0]


def everywhere(effect: str, *but: str) -> list[Finding]:
    return [finding(effect, j) for j in reversed(JOINTS) if j not in but]


@pytest.mark.parametrize(
    ("value", "spread", "words"),
    [
        (1.635, 0.008, "1.635 ± 0.008"),
        (2.41, 0.021, "2.410 ± 0.021"),
        (2.1, 0.098, "2.10 ± 0.10"),
        (12345.6, 1234.0, "12300 ± 1200"),
        (-1e-4, 0.02, "0.000 ± 0.020"),
        (0.04, 12.0, "0 ± 12"),
        (3e-9, 1e-10, "(3.00 ± 0.10)·10⁻⁹"),
        (1.3e7, 7e6, "(13 ± 7)·10⁶"),
        (-2.345e6, 1.2e4, "(−2.345 ± 0.012)·10⁶"),
        (4.0, 3e6, "(0.0 ± 3.0)·10⁶"),
        (654321.0, 9e4, "650000 ± 90000"),
        (1e-4, 5e-6, "0.000100 ± 0.000005"),
        (1e-5, 5e-5, "(10 ± 50)·10⁻⁶"),
        (1.0, 1e-9, "1.00 ± 1.00·10⁻⁹"),
        (1e9, 1.0, "1.00·10⁹ ± 1.00"),
        (1e12, 1e12, "(1.0 ± 1.0)·10¹²"),
        (1.0, 0.0, "1.00"),
        (2.1, math.nan, "2.10 ± –"),
    ],
)
def test_digits_follow_the_spread(value: float, spread: float, words: str) -> None:
    assert measure(value, spread) == words


def test_a_measure_says_its_numbers_to_a_tenth_of_the_spread() -> None:
    rng = np.random.default_rng(5)
    for sign, size, ratio in zip(
        rng.choice((-1, 1), 500), rng.uniform(-9, 9, 500), rng.uniform(-4, 2, 500), strict=True
    ):
        value, spread = sign * 10**size, 10 ** (size + ratio)
        told = measure(value, spread).replace("\N{MINUS SIGN}", "-")
        body, _, power = told.partition(")·10")
        assert len(told) < 26
        unit_ = 10.0 ** int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or 0)
        if "·" in body:
            continue
        said = [float(part) * unit_ for part in body.strip("(").split(" ± ")]
        assert abs(said[0] - value) <= 0.15 * spread
        assert abs(said[1] - spread) <= 0.15 * spread


def test_the_sign_of_a_difference_stands_before_its_digits() -> None:
    told = [signed(Difference(None, None, d, std, 1.0)) for d, std in ((0.7, 0.05), (1.3e7, 3e6), (-1.3e7, 3e6))]
    assert told == ["+0.70 ± 0.10", "(+13 ± 6)·10⁶", "(\N{MINUS SIGN}13 ± 6)·10⁶"]


def test_small_words() -> None:
    assert [percent(x) for x in (1e-9, 0.00024, 0.123, 3.64, math.nan)] == [
        "< 0.001 %",
        "0.024 %",
        "12 %",
        "364 %",
        "–",
    ]
    assert [unit("N m s^2/rad"), with_unit("0.1", "1"), with_unit("0.1", "m/s^2")] == ["kg m²", "0.1", "0.1 m/s²"]
    assert [joined([]), joined(["a"]), joined(["a", "b", "a", "c"], "or")] == ["", "a", "a, b or c"]


def test_all_joints_are_not_listed() -> None:
    assert all_or_some(JOINTS[::-1], JOINTS) == "all joints"
    assert all_or_some(JOINTS[1:], JOINTS) == "all joints but joint1"
    assert all_or_some(JOINTS[2:], JOINTS) == "all joints but joint1 and joint2"
    assert all_or_some(("joint3", "joint2"), JOINTS) == "joint2 and joint3"
    assert all_or_some(("joint1",), ("joint1",)) == "joint1"
    assert all_or_some(("joint1",), ("joint1", "joint2")) == "joint1"


def test_a_list_holds_as_many_words_as_it_may() -> None:
    assert as_many_as_fit(["a b", "c", "d e f"], 7) == "a b, c and d e f"
    assert as_many_as_fit(["a b", "c", "d e f"], 6, "or", "others") == "a b, c or 1 other"
    assert as_many_as_fit(["a b", "c", "d", "e"], 2, rest="more effects") == "a b and 3 more effects"
    assert as_many_as_fit(["a b c d", "e"], 2) == "a b c d and 1 more"


def test_the_headline_leads_with_what_removes_most_held_out_error() -> None:
    ripple = finding("torque_ripple", "joint2", nmse_before={"joint2": 0.2}, nmse_after={"joint2": 0.1})
    spring = finding("joint_spring", "joint1", log_evidence_gain=1.0)
    assert head(ripple, spring) == "The URDF lacks a joint spring at joint1 and torque ripple at joint2."
    friction = (*everywhere("coulomb_friction"), *everywhere("viscous_friction"))
    assert head(ripple, spring, *friction).startswith(
        "The URDF lacks viscous and Coulomb friction at all joints, a joint"
    )


def test_held_out_data_does_not_decide_what_is_in_the_headline() -> None:
    sure, here = finding("backlash", "joint1"), {"joint2": 0.3}
    unseen = finding("payload", links=("hand",), judged_on=OWN_TIME)
    useless = finding("joint_spring", "joint2", nmse_before=here, nmse_after=here)
    elsewhere = finding("torque_ripple", "joint2", held_out_ratio=Ratio(0.3, -0.2, 0.8))
    assert head(unseen, useless, elsewhere, sure) == (
        "The URDF lacks torque ripple at joint2, backlash at joint1, a payload on hand and a joint spring at joint2."
    )
    assert "Not confirmed on held-out data: 3 of 4 findings." in result(unseen, useless, elsewhere, sure).statement
    assert head(useless) == "The URDF lacks a joint spring at joint2."


@pytest.mark.parametrize(("share", "words"), [(0.85, "85 %"), (1.0, "100 %"), (0.0, "0 %")])
def test_how_many_repeated_searches_find_it_is_said(share: float, words: str) -> None:
    ripple = finding("torque_ripple", "joint2")
    assert f"{words} of the repeated searches find it again." in replace(ripple, stability=share).statement
    assert "repeated" not in ripple.statement


def test_what_the_urdf_has_is_called_wrong() -> None:
    other = {"viscous": Quantity(0.8, 0.1, "N m s/rad", urdf=0.3)}
    damped = finding("viscous_friction", "joint1", parameters=other)
    geometry = finding("geometry_error", "joint3", nmse_before={"joint3": 0.9})
    assert head(damped, geometry, finding("coulomb_friction", "joint1")) == (
        "The URDF has the wrong geometry at joint3 and viscous friction at joint1, and lacks "
        "Coulomb friction at joint1."
    )
    assert "0.80 ± 0.20 N m s/rad (URDF: 0.300)" in damped.statement


def test_every_kind_of_place_is_named_in_the_headline() -> None:
    load = Where(("load.csv",), ((2.0, 8.0),))
    assert head(finding("payload", links=("hand",), where=load), finding("base_tilt", log_evidence_gain=9.0)) == (
        "The URDF lacks a payload on hand (in load.csv, 2.0 to 8.0 s) and a tilted base."
    )
    assert head(finding("joint_coupling", "joint3", depends_on=("q_joint1",))) == (
        "The URDF lacks a coupling to joint1's position at joint3."
    )
    assert "lacks a one-sided spring" in head(finding("one_sided_spring", "joint1"))


def test_a_headline_of_many_findings_has_25_words_at_most() -> None:
    names = (
        "counterbalance",
        "joint_spring",
        "coupled_motor",
        "load_dependent_friction",
        "actuator_lag",
        "geometry_error",
    )
    found = [finding(name, f"joint{k + 1}", log_evidence_gain=float(-k)) for k, name in enumerate(names)]
    words = head(*found)
    assert len(words.split()) <= 25
    assert "more" in words


def test_unlikely_findings_stay_out_of_the_headline() -> None:
    assert head(finding("backlash", "joint1"), finding("joint_spring", "joint2", probability=0.2)) == (
        "The URDF lacks backlash at joint1."
    )


def test_the_statement_has_the_errors_and_what_remains() -> None:
    left = Unexplained(("joint6", "joint5"), (), Where(), 0.1)
    more = {"held_out_ratio": Ratio(1.0, 0.9, 1.1), "next_effect": NextEffect(12, "stribeck_friction", ("joint1",))}
    said = replace(result(finding("backlash", "joint1"), **more), unexplained=(left,)).statement
    assert "On held-out data the torque of the findings is 1.00 times the fitted torque (95 %: 0.90 to 1.10)." in said
    assert "A residual at joint5 and joint6 is unexplained." in said
    assert said.endswith("The search ended after 12 terms; the next likely effect is Stribeck friction at joint1.")


def test_a_finding_of_one_per_cent_leads_nothing() -> None:
    weak, strong = finding("backlash", "joint1", probability=0.01), finding("rotor_inertia", "joint2")
    sure = finding("joint_spring", "joint3", nmse_before={"joint3": 0.9})
    assert strongest_first((weak, strong, sure)) == (sure, strong, weak)


def test_a_guess_is_called_so_behind_its_rival() -> None:
    rivals = Alternative("joint_spring", ("joint1",)), Alternative("base_tilt")
    alone = finding("backlash", "joint1", probability=0.4)
    one = replace(alone, indistinguishable_from=rivals)
    assert alone.statement.startswith("Possibly backlash at joint1: size")
    assert one.statement.startswith("Joint spring or possibly backlash at joint1: size")
    assert "cannot distinguish it from a joint spring or a tilted base" in one.statement
    assert guessed(replace(one, probability=0.51)) == "backlash"
    assert head(one) == "The URDF lacks an effect: a joint spring or backlash at joint1."


@pytest.mark.parametrize(
    ("one", "begin"),
    [
        (finding("coulomb_friction", "joint1", parameters={"coulomb": Quantity(1.2, 0.01, "N m")}),
         "Coulomb friction at joint1: 1.200 ± 0.020 N m (95 % intervals)."),
        (finding("velocity_coupling", "joint2", depends_on=("qd_joint4",)),
         "Coupling to joint4's velocity at joint2: size 1.635 ± 0.008 N m (95 % intervals)."),
        (finding("payload", links=("hand",), where=Where(("a.csv",), ((2.0, 8.04),))),
         "Payload on hand (in a.csv, 2.0 to 8.0 s): size"),
        (finding("base_tilt"), "Tilted base on the whole robot: size"),
        (finding("position_dependent_friction", "joint1", where=Where(region=(Region("q_joint1", -0.1234, 0.5),))),
         "Friction that depends on position at joint1 (q_joint1 from −0.123 to 0.5): size"),
        (finding("third_party_effect", "joint1", depends_on=("q_joint2",)),
         "Third party effect that depends on the position of joint2 at joint1: size"),
    ],
)  # fmt: skip
def test_a_sentence_begins_with_name_and_place(one: Finding, begin: str) -> None:
    assert one.statement.startswith(begin)


def test_a_sentence_says_recordings_and_whether_it_adds_to_others() -> None:
    one = finding("coulomb_friction", "joint1", where=Where(("a.csv", "b.csv")))
    begin = "Coulomb friction at joint1 (only in a.csv and b.csv): size 1.635 ± 0.008 N m (95 % intervals)."
    assert one.statement.startswith(begin)
    assert replace(one, adds_to_all=True).statement.startswith(f"{begin} It adds to the same effect in all recordings.")


def test_a_sentence_says_the_coulomb_friction_of_all_laws_together() -> None:
    one = replace(finding("coulomb_friction", "joint1"), coulomb_in_motion=Quantity(0.3, 0.01, "N m"))
    assert "All friction laws of joint1 together: Coulomb friction 0.300 ± 0.020 N m (95 % interval)." in one.statement


def test_a_sentence_holds_the_first_few_of_many_quantities() -> None:
    ten = {f"p_{k}": Quantity(float(k), 0.0, "kg") for k in range(10)}
    assert finding("payload", links=("hand",), parameters=ten).statement.startswith(
        "Payload on hand: p 0 0 kg, p 1 1.00 kg, p 2 2.00 kg, p 3 3.00 kg. "
    )


def test_a_sentence_names_properties_of_the_robot_alone() -> None:
    """Below which frequencies a recording shows a delay is a number of the recording."""
    quantities = {"delay": Quantity(0.006, 0.0005, "s"), "step": Quantity(0.006, 0.0, "s")}
    told = finding("time_delay", "joint1", parameters={**quantities, "bandwidth": Quantity(12.0, 3.0, "Hz")})
    assert told.statement.startswith("Time delay of the torque at joint1: 0.0060 ± 0.0010 s (95 % intervals).")
    assert more_values(told) == 0


def test_a_sentence_does_not_say_a_kind_of_zero() -> None:
    """Friction is the motor's unless told otherwise."""
    for link, more in ((0.0, ""), (1.0, ", friction of the link")):
        quantities = {"stiffness": Quantity(200.0, 4.0, "N m/rad"), "link_friction": Quantity(link, 0.0, "1")}
        told = finding("joint_elasticity", "joint1", parameters=quantities).statement
        assert told.startswith(f"Joint elasticity at joint1: stiffness 200 ± 8 N m/rad{more} (95 % intervals).")


def test_a_sentence_says_where_no_parameter_differs_from_zero() -> None:
    load = {"mass": Quantity(math.nan, math.nan, "kg"), "Iyy": Quantity(-0.03, 0.09, "kg m^2")}
    unsure = "No single parameter differs significantly from zero; together they do."
    assert unsure in finding("payload", links=("hand",), parameters=load).statement
    sure = load | {"Izz": Quantity(0.03, 0.009, "kg m^2")}
    assert unsure not in finding("payload", links=("hand",), parameters=sure).statement


def test_a_significant_angle_is_no_significant_torque() -> None:
    crank = {"dead_centre": Quantity(1.5, 0.1, "rad"), "crank_ratio": Quantity(0.9, 0.1, "1")}
    for spring, sure in ((0.3, False), (0.01, True)):
        torques = {name: Quantity(0.5, std, "N m") for name, std in (("spring_torque", spring), ("force_torque", 0.4))}
        said = finding("counterbalance", "joint1", parameters={**torques, **crank}).statement
        words = "Spring torque and force torque do not differ significantly from zero one by one; together they do."
        assert (words in said) is not sure


def test_a_sentence_does_not_say_a_region_twice() -> None:
    contact = {"contact_position": Quantity(0.1, 0.01, "rad")}
    where = Where(region=(Region("q_joint1", 0.1, 0.5),))
    assert "q_joint1" not in finding("one_sided_spring", "joint1", parameters=contact, where=where).statement


def test_a_sentence_says_what_it_is_worth_where_it_is_worth_most() -> None:
    worth: dict[str, Any] = {
        "nmse_before": {"joint1": 0.02, "joint2": 0.5},
        "nmse_after": {"joint1": 0.02, "joint2": 0.1},
    }
    for one in (finding("base_tilt", **worth), finding("backlash", "joint1", **worth)):
        assert one.statement.endswith("The NMSE of joint2 on held-out data falls from 0.500 to 0.100 with it.")
    there = finding("backlash", "joint1", **worth, held_out_ratio=Ratio(-0.204, -1.0, 0.5))
    assert there.statement.endswith(
        "Its torque there is −0.20 times the fitted torque (95 %: −1.00 to 0.50). Not confirmed on held-out data."
    )
    nowhere = {key: {"joint1": 0.02, "joint2": 0.5} for key in worth}
    assert finding("backlash", "joint1", **nowhere).statement.endswith(
        "Not confirmed on held-out data: the NMSE of joint1 is 0.0200 with it and without it."
    )
    assert finding("payload", **worth, judged_on=OWN_TIME).statement.endswith(
        "Not confirmed on held-out data: it does not act there. Cross-validated in its own window, the NMSE of joint2 "
        "falls from 0.500 to 0.100."
    )
    brief = finding("payload", nmse_before={}, nmse_after={}, judged_on="")
    assert brief.statement.endswith("Its own window of time is too short for cross-validation.")


@pytest.mark.parametrize(
    ("probability", "elpd", "words"),
    [
        (0.9, Elpd(40.0, 5.0, 12.0, 0.8, 0.3), ""),
        (0.2, Elpd(2.0, 5.0, 0.4, 0.8, 0.3),
         " Cross-validation does not confirm it: log evidence 0.400 nats on left-out blocks, 12.0 nats in the search."),
        (0.2, Elpd(0.0, 0.0, 0.0, 0.0, 0.0),
         " Cross-validation does not confirm it: log evidence unknown on left-out blocks, 12.0 nats in the search."),
        (0.9, Elpd(40.0, 5.0, 12.0, 0.8, 0.0004),
         " It is negligible: 80 % of the squared error of left-out blocks, 0.04 % of the torque."),
        (0.9, Elpd(40.0, 5.0, 12.0, 0.012, 0.3),
         " It is negligible: 1.2 % of the squared error of left-out blocks, 30 % of the torque."),
    ],
    ids=["confirmed", "by chance", "too short", "little torque", "little error"],
)  # fmt: skip
def test_a_sentence_says_why_cross_validation_does_not_confirm_it(probability: float, elpd: Elpd, words: str) -> None:
    plain = replace(finding("backlash", "joint1"), probability=probability, log_evidence_gain=12.0)
    begin, mark, rest = plain.statement.partition("(95 % intervals).")
    assert replace(plain, elpd=elpd).statement == f"{begin}{mark}{words}{rest}"


def test_what_is_not_confirmed_is_not_said_to_differ_from_zero() -> None:
    """Two numbers whose intervals hold zero may differ from zero together, if cross-validation confirms them."""
    small = {"p": Quantity(0.1, 9.0, "kg"), "r": Quantity(0.1, 9.0, "kg")}
    one = replace(finding("backlash", "joint1"), parameters=small, elpd=Elpd(40.0, 5.0, 12.0, 0.8, 0.3))
    assert "together they do" in replace(one, probability=0.9).statement
    assert "together they do" not in replace(one, probability=0.2).statement


def test_another_variant_is_asked_for() -> None:
    said = finding("geometry_error", "joint2", variant=Variant("upper", 0.42, 0.3)).statement
    assert "It would be 0.42 m from the origin of upper; the URDF says 0.3 m." in said


def test_alternatives_say_their_place_where_it_is_another() -> None:
    others = (
        Alternative("joint_coupling", ("joint1",), (), ("q_joint2",)),
        Alternative("joint_coupling", ("joint1",), (), ("q_joint3",)),
        Alternative("backlash", ("joint2",)), Alternative("base_tilt"), Alternative("payload", (), ("hand",)),
        Alternative("backlash", ("joint2",)),
    )  # fmt: skip
    one = finding("joint_spring", "joint1", indistinguishable_from=others)
    assert alternatives(one) == [
        "coupling to joint2's position", "coupling to joint3's position", "backlash at joint2",
        "tilted base on the whole robot", "payload on hand",
    ]  # fmt: skip
    assert one.statement.endswith("from a coupling to joint2's position, a coupling to joint3's position or 3 others.")


def test_times_have_open_ends_and_units() -> None:
    assert when(Where()) == ""
    spans = Where(None, ((-math.inf, 3.0), (7.25, math.inf)), (Region("q_joint1", -1.0, 2.0),))
    assert when(spans, {"q_joint1": "rad"}) == "until 3.0 s, from 7.2 s on, q_joint1 from −1 to 2 rad"


@pytest.mark.parametrize(
    ("ratio", "said"), [(Ratio(1.3, 1.1, 1.6), True), (Ratio(1.01, 1.005, 1.02), False), (Ratio(1.3, 0.9, 1.6), False)]
)
def test_errors_above_the_baseline_are_said_if_they_are_certain_and_count(ratio: Ratio, said: bool) -> None:
    less = Ratio(0.1, 0.05, 0.2)
    check = HeldOutCheck("joint1", {"baseline": ratio, "rigid_body": less, "urdf": less}, {}, 0.1)
    words = replace(result(finding("backlash", "joint1")), held_out_checks=(check,)).statement
    assert ("squared error exceeds that of least squares with friction at joint1" in words) is said
