"""Sentences that name every kind of place, and numbers with the digits that their spread leaves."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from torchrbd.diagnosis.changes.results import Difference
from torchrbd.diagnosis.changes.words import signed
from torchrbd.diagnosis.numbers import joined, measure, percent, unit, with_unit
from torchrbd.diagnosis.results import (
    OWN_TIME,
    Alternative,
    Finding,
    Quantity,
    Ratio,
    Region,
    Unexplained,
    Where,
)
from torchrbd.diagnosis.verdict_words import ended_statement, verdict_statement
from torchrbd.diagnosis.words import (
    all_or_some,
    alternatives,
    finding_sentence,
    guessed,
    more_values,
    strongest_first,
    when,
)
from torchrbd.inference.torque_error import Fit

JOINTS = tuple(f"joint{k}" for k in range(1, 8))


def finding(effect: str, *joints: str, links: tuple[str, ...] = (), **changes: Any) -> Finding:
    quantities = {"size": Quantity(1.635, 0.004, "N m")}
    plain = Finding(effect, joints, links, 0.99, 50.0, quantities, Where(), (), {}, {}, "")
    return replace(plain, **changes)


def statement(*findings: Finding, rest: tuple[Unexplained, ...] = ()) -> str:
    fit = Fit(dict.fromkeys(JOINTS, 0.1), {})
    return verdict_statement("missing_physics", findings, rest, dict.fromkeys(("urdf", "rigid_body", "extended"), fit))


def test_the_verdict_says_how_much_of_it_is_there() -> None:
    fits = dict.fromkeys(("urdf", "rigid_body", "extended"), Fit({"joint1": 0.1}, {}))
    told = verdict_statement("missing_physics", [finding("backlash", "joint1")], (), fits, confirmed=Ratio(1, 0.9, 1.1))
    assert told.endswith(
        "10 % with what was found, which held-out time has 1.00 times as large as found (0.90 to 1.10)."
    )


def test_a_search_that_ends_early_says_so() -> None:
    assert ended_statement(12, "") == ""
    assert ended_statement(12, "Stribeck friction at joint1") == (
        "The search ends with 12 terms, though more is likelier than not beside them: first of all Stribeck friction "
        "at joint1."
    )
    assert ended_statement(1, "backlash at joint1").startswith("The search ends with 1 term, though")


def test_a_one_sided_spring_has_the_article_that_is_spoken() -> None:
    fits = dict.fromkeys(("urdf", "rigid_body", "extended"), Fit({"joint1": 0.1}, {}))
    told = verdict_statement("missing_physics", [finding("one_sided_spring", "joint1")], (), fits)
    assert "leaves out a one-sided spring" in told


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


def test_special_effects_come_before_the_friction_that_all_robots_have() -> None:
    ripple = finding("torque_ripple", "joint2", log_evidence_gain=1.0)
    told = statement(
        *everywhere("coulomb_friction"), *everywhere("viscous_friction"), ripple,
        *everywhere("torque_offset", *JOINTS[2:]),
    )  # fmt: skip
    assert told.startswith(
        "The URDF leaves out torque ripple at joint2. It also leaves out viscous and Coulomb friction at all joints "
        "and a constant torque offset at joint1 and joint2. The unpredicted part"
    )


def test_friction_alone_is_the_first_sentence() -> None:
    told = statement(*everywhere("viscous_friction", "joint4"), finding("coulomb_friction", "joint1"))
    assert told.startswith(
        "The URDF leaves out viscous friction at all joints but joint4 and Coulomb friction at joint1. The unpredicted"
    )


def test_what_the_urdf_has_is_called_wrong() -> None:
    other = {"viscous": Quantity(0.8, 0.1, "N m s/rad", urdf=0.3)}
    damped = finding("viscous_friction", "joint1", parameters=other)
    geometry = finding("geometry_error", "joint3")
    told = statement(damped, geometry, finding("coulomb_friction", "joint1"))
    assert told.startswith(
        "The URDF has the wrong geometry (joint origin or axis) at joint3. It also leaves out Coulomb friction at "
        "joint1 and has the wrong viscous friction at joint1. "
    )
    assert "0.80 ± 0.20 N m s/rad (the URDF says 0.300)" in finding_sentence(damped)


def test_every_kind_of_place_is_named_in_the_verdict() -> None:
    load = Where(("load.csv",), ((2.0, 8.0),))
    coupled = finding("joint_coupling", "joint3", depends_on=("q_joint1",))
    told = statement(
        finding("payload", links=("hand",), where=load),
        finding("external_wrench", links=("link2",), where=Where(("b.csv",))),
        coupled,
        finding("base_tilt"),
        finding("time_delay"),
        rest=(Unexplained(("joint6", "joint5"), (), Where(), 0.1, ""),),
    )
    assert told.startswith(
        "The URDF leaves out a payload on hand (in load.csv, 2.0 to 8.0 s), "
        "an external force or moment on link2 (only in b.csv), a coupling to joint1's position at joint3, "
        "a tilted base and a time delay of the torque. "
    )
    assert told.endswith("Something is left unexplained at joint5 and joint6.")


def test_a_verdict_of_many_findings_stays_a_sentence() -> None:
    names = ("backlash", "joint_spring", "torque_ripple", "cable_drag", "actuator_lag", "torque_scale", "rotor_inertia")
    told = statement(*(finding(name, f"joint{k + 1}") for k, name in enumerate(names)))
    assert "a joint spring at joint2" in told
    assert "actuator lag at joint5 and 2 more. " in told


def test_unlikely_findings_stay_out_of_the_verdict() -> None:
    told = statement(finding("backlash", "joint1"), finding("joint_spring", "joint2", probability=0.2))
    assert "backlash at joint1." in told
    assert "spring" not in told


def test_a_finding_of_one_per_cent_leads_nothing() -> None:
    weak, strong = finding("backlash", "joint1", probability=0.01), finding("rotor_inertia", "joint2")
    weak = replace(weak, log_evidence_gain=900.0)
    sure = finding("joint_spring", "joint3", log_evidence_gain=60.0)
    told = strongest_first((weak, strong, sure))
    assert told == (sure, strong, weak)


def test_a_guess_is_called_so_behind_its_rival() -> None:
    rivals = Alternative("joint_spring", ("joint1",)), Alternative("base_tilt")
    alone = finding("backlash", "joint1", probability=0.4)
    one = replace(alone, indistinguishable_from=rivals)
    assert finding_sentence(alone).startswith("joint1: perhaps backlash, size")
    assert finding_sentence(one).startswith("joint1: joint spring or perhaps backlash, size")
    assert "cannot tell it from joint spring or tilted base" in finding_sentence(one)
    assert guessed(replace(one, probability=0.51)) == "backlash"
    assert statement(one).startswith(
        "The URDF leaves something out, perhaps a joint spring or backlash at joint1. The unpredicted part"
    )
    assert statement(alone, finding("time_delay", probability=0.3)).startswith(
        "The URDF leaves something out, perhaps backlash at joint1 and a time delay of the torque. The"
    )


@pytest.mark.parametrize(
    ("one", "begin"),
    [
        (finding("coulomb_friction", "joint1", parameters={"coulomb": Quantity(1.2, 0.01, "N m")}),
         "joint1: Coulomb friction, 1.200 ± 0.020 N m (± 95 %)."),
        (finding("velocity_coupling", "joint2", depends_on=("qd_joint4",)),
         "joint2: coupling to joint4's velocity, size 1.635 ± 0.008 N m (± 95 %)."),
        (finding("payload", links=("hand",), where=Where(("a.csv",), ((2.0, 8.04),))),
         "hand: payload (in a.csv, 2.0 to 8.0 s), size"),
        (finding("base_tilt"), "Whole robot: tilted base, size"),
        (finding("cable_drag", "joint1", where=Where(region=(Region("q_joint1", -0.1234, 0.5),))),
         "joint1: cable drag over a range of positions (q_joint1 from −0.123 to 0.5), size"),
        (finding("third_party_effect", "joint1", depends_on=("q_joint2",)),
         "joint1: third party effect that depends on q_joint2, size"),
    ],
)  # fmt: skip
def test_a_sentence_begins_with_place_and_name(one: Finding, begin: str) -> None:
    assert finding_sentence(one).startswith(begin)


def test_a_sentence_tells_recordings_and_whether_it_comes_on_top() -> None:
    one = finding("coulomb_friction", "joint1", where=Where(("a.csv", "b.csv")))
    begin = "joint1: Coulomb friction (only in a.csv and b.csv), size 1.635 ± 0.008 N m (± 95 %)"
    assert finding_sentence(one).startswith(f"{begin}.")
    assert finding_sentence(one, more=True).startswith(f"{begin}, on top of that of all recordings.")


def test_a_sentence_holds_the_first_few_of_many_quantities() -> None:
    ten = {f"p_{k}": Quantity(float(k), 0.0, "kg") for k in range(10)}
    assert finding_sentence(finding("payload", links=("hand",), parameters=ten)) == (
        "hand: payload, p 0 0 kg, p 1 1.00 kg, p 2 2.00 kg, p 3 3.00 kg."
    )


def test_a_sentence_names_properties_of_the_robot_alone() -> None:
    """Below which frequencies a recording shows a delay is a number of the recording."""
    quantities = {"delay": Quantity(0.006, 0.0005, "s"), "step": Quantity(0.006, 0.0, "s")}
    told = finding("time_delay", "joint1", parameters={**quantities, "bandwidth": Quantity(12.0, 3.0, "Hz")})
    assert finding_sentence(told).startswith("joint1: time delay of the torque, 0.0060 ± 0.0010 s (± 95 %).")
    assert more_values(told) == 0


def test_a_sentence_does_not_say_a_kind_of_zero() -> None:
    """Friction is the motor's unless told otherwise."""
    for link, more in ((0.0, ""), (1.0, ", friction of the link")):
        quantities = {"stiffness": Quantity(200.0, 4.0, "N m/rad"), "link_friction": Quantity(link, 0.0, "1")}
        told = finding_sentence(finding("joint_elasticity", "joint1", parameters=quantities))
        assert told.startswith(f"joint1: joint elasticity, stiffness 200 ± 8 N m/rad{more} (± 95 %).")


def test_a_sentence_says_where_no_number_is_told_from_zero() -> None:
    load = {"mass": Quantity(math.nan, math.nan, "kg"), "Iyy": Quantity(-0.03, 0.09, "kg m^2")}
    untold = "No number of it is told from zero; together they are."
    assert finding_sentence(finding("payload", links=("hand",), parameters=load)).endswith(untold)
    told = load | {"Izz": Quantity(0.03, 0.009, "kg m^2")}
    assert untold not in finding_sentence(finding("payload", links=("hand",), parameters=told))


def test_an_angle_that_is_told_is_no_torque_that_is() -> None:
    crank = {"dead_centre": Quantity(1.5, 0.1, "rad"), "crank_ratio": Quantity(0.9, 0.1, "1")}
    for spring, told in ((0.3, False), (0.01, True)):
        torques = {name: Quantity(0.5, std, "N m") for name, std in (("spring_torque", spring), ("force_torque", 0.4))}
        sentence = finding_sentence(finding("counterbalance", "joint1", parameters={**torques, **crank}))
        words = "Spring torque and force torque are not told from zero one by one; together they are."
        assert sentence.endswith(words) is not told


def test_a_sentence_does_not_say_a_region_twice() -> None:
    ends = {"start": Quantity(0.1, 0.01, "rad"), "end": Quantity(0.5, 0.01, "rad")}
    drag = finding("cable_drag", "joint1", parameters=ends, where=Where(region=(Region("q_joint1", 0.1, 0.5),)))
    assert "from" not in finding_sentence(drag)


def test_a_sentence_says_what_it_is_worth_where_it_is_worth_most() -> None:
    worth: dict[str, Any] = {
        "nmse_before": {"joint1": 0.02, "joint2": 0.5},
        "nmse_after": {"joint1": 0.02, "joint2": 0.1},
    }
    for one in (finding("base_tilt", **worth), finding("backlash", "joint1", **worth)):
        assert finding_sentence(one).endswith(
            "Without it 50 % of the torque variance of joint2 on held-out time stays unpredicted, with it 10 %."
        )
    there = finding("backlash", "joint1", **worth, confirmed=Ratio(-0.204, -1.0, 0.5))
    assert finding_sentence(there).endswith(
        "with it 10 %; held-out time has it −0.20 times as large as found (−1.00 to 0.50)."
    )
    nowhere = {key: {"joint1": 0.02, "joint2": 0.5} for key in worth}
    assert finding_sentence(finding("backlash", "joint1", **nowhere)).endswith(
        "Held-out time does not show it: 2 % of the torque variance stays unpredicted with and without it."
    )
    alone = finding("payload", **worth, judged_on=OWN_TIME)
    assert finding_sentence(alone).endswith(
        "Held-out time sees nothing of it; of its own, each half predicted by a fit to the other, 50 % of the torque "
        "variance of joint2 stays unpredicted without it and 10 % with it."
    )
    brief = finding("payload", nmse_before={}, nmse_after={}, judged_on="")
    assert finding_sentence(brief).endswith("Held-out time sees nothing of it, and its own is too short to be divided.")


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
    assert finding_sentence(one).endswith("backlash at joint2, tilted base on the whole robot or payload on hand.")


def test_when_tells_open_ends_and_units() -> None:
    assert when(Where()) == ""
    spans = Where(None, ((-math.inf, 3.0), (7.25, math.inf)), (Region("q_joint1", -1.0, 2.0),))
    assert when(spans, {"q_joint1": "rad"}) == "until 3.0 s, from 7.2 s on, q_joint1 from −1 to 2 rad"
