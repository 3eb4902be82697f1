"""How likely terms are: against sums over all that may be in a place, and what rarity and rivals take."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from likelihood.arms import recorded, rows_of, wrong_robot
from likelihood.fits import OPTIONS, URDF, candidate, carried, fitted, with_friction
from robot.random_robots import random_urdf
from scipy.special import comb
from scipy.stats import betabinom

from torchrbd.dataset.rows import Rows
from torchrbd.diagnosis.calibration import calibrated
from torchrbd.diagnosis.hypotheses import Hypothesis
from torchrbd.diagnosis.outcome import Term
from torchrbd.diagnosis.posterior import (
    EXPECTED,
    Inclusion,
    curve_log_odds,
    excess_evidence,
    inclusion,
    limit_evidence,
    log_odds,
    prior_log_odds,
    probability_of,
    refit_matters,
)
from torchrbd.diagnosis.results import Elpd
from torchrbd.effects import Effect, Site, Window, effect, known_effects
from torchrbd.effects.smooth_torque import SMOOTH
from torchrbd.likelihood.learning import learn
from torchrbd.likelihood.machine import Machine
from torchrbd.robot import RobotModel

ARM = RobotModel.from_urdf(random_urdf(3, 7, kinds=("revolute",), branching=0.0, massless=0.0))


@pytest.fixture(scope="module")
def rows() -> Rows:
    return carried(fitted())


def hypothesis(rows: Rows, name: str, site: Site, log_evidence: float, **shape: float) -> Hypothesis:
    c = candidate(rows, name, site, **shape)
    K = len(c.labels)
    return Hypothesis(c, log_evidence, np.zeros(K), np.ones(K), 1.0, 1)


def drawn(rows: Rows, seed: int) -> list[Hypothesis]:
    """Return hypotheses of several families and places with evidence that is drawn."""
    rng = np.random.default_rng(seed)
    names = ("joint_spring", "rotor_inertia", "quadratic_drag", "torque_scale")
    return [
        hypothesis(rows, name, Site(j), float(rng.normal(5.0, 20.0 if seed % 2 else 3.0)))
        for name in names
        for j in (0, 1)
    ]


def told(found: list[Hypothesis], k: int, rows: Rows) -> Inclusion:
    return inclusion(found[k], [h for i, h in enumerate(found) if i != k], rows)


def test_odds_are_prior_odds_shared_out_over_places_times_the_evidence(rows: Rows) -> None:
    spring = hypothesis(rows, "joint_spring", Site(1), 7.0)
    assert log_odds(spring, rows) == pytest.approx(calibrated(7.0) + math.log(EXPECTED["common"] / 2))
    drag = hypothesis(rows, "quadratic_drag", Site(0), 7.0)
    assert log_odds(spring, rows) - log_odds(drag, rows) == pytest.approx(
        math.log(EXPECTED["common"] / EXPECTED["rare"])
    )
    n = ARM.n_dof
    assert prior_log_odds(effect("joint_coupling"), ARM) == pytest.approx(math.log(EXPECTED["rare"] / (n * (n - 1))))
    # What acts for a time has its links as places.
    assert prior_log_odds(effect("payload"), ARM) == pytest.approx(math.log(EXPECTED["common"] / ARM.n_bodies))
    assert prior_log_odds(effect("coulomb_friction"), ARM) == 0.0


def test_drives_of_one_robot_are_alike(rows: Rows) -> None:
    """A rotor at one more joint is as likely as in a beta-binomial distribution; a spring knows no others."""
    law, robot = effect("rotor_inertia"), rows.columns.robot
    n = robot.n_dof

    def log_probability(m: int) -> float:
        return float(betabinom.logpmf(m, n, EXPECTED[law.prevalence], 1.0)) - math.log(comb(n, m))

    steps = [prior_log_odds(law, robot, m) for m in range(n)]
    assert steps == pytest.approx([log_probability(m + 1) - log_probability(m) for m in range(n)], abs=1e-9)
    at = {name: [hypothesis(rows, name, Site(j), 7.0) for j in (0, 1)] for name in (law.id, "joint_spring")}
    every = [h for several in at.values() for h in several]
    first, spring = at[law.id][0], at["joint_spring"][0]
    assert first.count_elsewhere(every).elsewhere == 1
    assert first.count_elsewhere([first, *at["joint_spring"]]).elsewhere == 0
    assert log_odds(first.count_elsewhere(every), rows) - log_odds(first, rows) == pytest.approx(steps[1] - steps[0])
    assert log_odds(spring.count_elsewhere(every), rows) == log_odds(spring, rows)


@pytest.mark.parametrize("tried", [7, 40])
def test_curves_are_as_common_as_a_machine_shows(tried: int) -> None:
    """One more curve is as likely as in a beta-binomial distribution, where each set of so many is as likely."""
    expected = 6 * EXPECTED["unknown"]

    def log_probability(m: int) -> float:
        return float(betabinom.logpmf(m, tried, expected, 1.0)) - math.log(comb(tried, m))

    steps = [curve_log_odds(m, tried, 6) for m in range(tried)]
    assert steps == pytest.approx([log_probability(m + 1) - log_probability(m) for m in range(tried)], abs=1e-9)
    assert steps == sorted(steps)
    # The first is as rare as an effect of family "unknown" at its place.
    assert steps[0] == pytest.approx(math.log(expected / tried))


def test_a_load_is_not_expected_to_be_there_for_a_moment_only(rows: Rows) -> None:
    """A push is: of two that explain a short time alike, the force is the likelier one the shorter it was."""

    def odds(name: str, *seconds: float) -> float:
        return log_odds(hypothesis(rows, name, Site(body=1, window=Window("fit", *seconds)), 20.0), rows)

    usual, briefly, moment = (odds("payload", 5.0, end) for end in (20.0, 7.0, 5.5))
    assert usual == odds("payload", 5.0) == odds("payload")
    assert usual - briefly == pytest.approx(0.5 * (math.log(5.0) / math.log(3.0)) ** 2)
    assert moment < briefly < usual
    assert odds("external_wrench", 5.0, 5.5) == odds("external_wrench", 5.0, 20.0)


@pytest.mark.parametrize("seed", range(6))
def test_probabilities_are_shares_of_all_that_may_be_there(rows: Rows, seed: int) -> None:
    found = drawn(rows, seed)
    each = [told(found, k, rows) for k in range(len(found))]
    odds = np.array([math.exp(log_odds(h, rows)) for h in found])
    np.testing.assert_allclose([one.probability for one in each], odds / (1.0 + odds.sum()), rtol=1e-9)
    assert sum(one.probability for one in each) <= 1.0
    for one in each:
        assert one.probability <= one.family_probability <= one.class_probability
        assert one.class_probability == pytest.approx(odds.sum() / (1.0 + odds.sum()))
        laws = [p for _, p in one.laws]
        assert laws == sorted(laws, reverse=True)
        assert sum(laws) == pytest.approx(1.0)
        best = max(found, key=lambda h: log_odds(h, rows))
        assert one.laws[0][0] is best


def test_nothing_is_probable_where_physics_allows_nothing(rows: Rows) -> None:
    spring, rotor = (hypothesis(rows, name, Site(0), -math.inf) for name in ("joint_spring", "rotor_inertia"))
    one = inclusion(spring, [rotor], rows)
    assert one.probability == one.class_probability == 0.0
    assert [p for _, p in one.laws] == [0.0, 0.0]


def test_equal_rivals_share(rows: Rows) -> None:
    spring = hypothesis(rows, "joint_spring", Site(0), 40.0)
    rotor = hypothesis(rows, "rotor_inertia", Site(0), 40.0)
    one = inclusion(spring, [rotor], rows)
    assert one.probability == pytest.approx(0.5, abs=1e-6)
    assert [p for _, p in one.laws] == pytest.approx([0.5, 0.5])
    assert inclusion(spring, [], rows).probability > 0.999


def test_rivals_of_its_family_at_its_joint_leave_the_family_sure(rows: Rows) -> None:
    drag = hypothesis(rows, "quadratic_drag", Site(0), 40.0)
    kin = hypothesis(rows, "power_law_friction", Site(0), 40.0, exponent=0.5)
    elsewhere = hypothesis(rows, "quadratic_drag", Site(1), 40.0)
    other = hypothesis(rows, "torque_ripple", Site(0), 40.0, order=3.0)
    assert kin.candidate.effect.family == drag.candidate.effect.family != other.candidate.effect.family
    sure = inclusion(drag, [kin], rows)
    assert sure.probability < 0.5
    assert sure.family_probability > 0.999
    for rival in (elsewhere, other):
        one = inclusion(drag, [rival], rows)
        assert one.family_probability == pytest.approx(one.probability)


def test_what_is_hardly_there_is_hardly_there_whatever_its_rivals(rows: Rows) -> None:
    spring, rotor = (hypothesis(rows, name, Site(0), -5.0) for name in ("joint_spring", "rotor_inertia"))
    one = inclusion(spring, [rotor], rows)
    assert one.family_probability < 0.01
    assert one.laws[0][1] == pytest.approx(0.5)


@pytest.mark.parametrize("size", [1e5, -1e5, -math.inf])
def test_evidence_of_any_size_has_a_probability(rows: Rows, size: float) -> None:
    far, near = hypothesis(rows, "joint_spring", Site(0), size), hypothesis(rows, "rotor_inertia", Site(0), 3.0)
    for one in (inclusion(far, [near], rows), inclusion(near, [far], rows)):
        assert 0.0 <= one.probability <= one.family_probability <= 1.0
        assert all(0.0 <= p <= 1.0 for _, p in one.laws)
    assert inclusion(far, [near], rows).probability == pytest.approx(float(size > 0), abs=1e-6)


@pytest.mark.parametrize("robot", [ARM, RobotModel.from_urdf(URDF)], ids=["seven joints", "two joints"])
def test_a_curve_that_is_three_nats_ahead_of_a_law_does_not_come_first(robot: RobotModel) -> None:
    """At as many places, whichever they are."""
    lead = calibrated(13.0) - calibrated(10.0)

    def places(e: Effect) -> int:
        return len(e.sites(robot, (Window("a"),)))

    pairs = [(curve, law) for curve in SMOOTH for law in known_effects().values() if places(curve) == places(law)]
    assert len({curve.id for curve, _ in pairs}) == len(SMOOTH)
    ahead = [
        (curve.id, law.id) for curve, law in pairs if prior_log_odds(curve, robot) + lead >= prior_log_odds(law, robot)
    ]
    assert ahead == []


def test_probability_of_what_is_as_likely_as_not_grows_with_the_evidence() -> None:
    found = [probability_of(x) for x in (-800.0, -10.0, 0.0, 10.0, 800.0)]
    assert found == sorted(found)
    assert found[0] == pytest.approx(0.0)
    assert found[1] < 0.01
    assert found[2] <= 0.5
    assert found[3] > 0.99
    assert found[4] == pytest.approx(1.0)


def test_a_refit_matters_where_the_urdf_is_wrong() -> None:
    right = RobotModel.from_urdf(URDF)
    recording = recorded(URDF, 2, with_friction(), **{**OPTIONS, "duration_s": 10.0})
    assert not refit_matters(learn(Machine(rows_of(right, [recording]))))
    assert refit_matters(learn(Machine(rows_of(wrong_robot(URDF, 1), [recording]))))


def test_a_term_is_told_by_its_window_too(rows: Rows) -> None:
    """Two that differ in their evidence alone are two."""
    one = hypothesis(rows, "joint_spring", Site(0), 9.0)
    again = inclusion(one, [replace(one, log_evidence=8.0)], rows)
    assert len(again.laws) == 2
    assert again.probability > again.laws[1][1]


def left_out(log_evidence: float) -> Elpd:
    """What left-out blocks say."""
    return Elpd(9.0, 3.0, log_evidence, 0.5, 0.5)


@pytest.mark.parametrize("log_evidence", [-3.0, 2.0, 30.0, 300.0])
def test_no_term_is_surer_than_left_out_blocks_make_it(rows: Rows, log_evidence: float) -> None:
    spring, rotor = (
        hypothesis(rows, name, Site(0), nats) for name, nats in (("joint_spring", 44.0), ("rotor_inertia", 40.0))
    )
    own, (rival,) = limit_evidence(spring, [rotor], left_out(log_evidence))
    prior = prior_log_odds(effect("joint_spring"), rows.columns.robot)
    assert log_odds(own, rows) == pytest.approx(min(log_odds(spring, rows), log_evidence + prior))
    assert own.log_evidence - rival.log_evidence == pytest.approx(4.0)
    excess = excess_evidence(44.0, log_evidence)
    assert calibrated(44.0 - excess) == pytest.approx(min(calibrated(44.0), log_evidence))
    assert limit_evidence(spring, [rotor], None) == (spring, (rotor,))


def test_a_law_that_is_not_needed_leaves_its_likeliest_part(rows: Rows) -> None:
    """A spring is an offset and a stiffness: its odds against the offset are those of a stiffness, not needed."""
    spring, offset = (
        hypothesis(rows, name, Site(0), nats) for name, nats in (("joint_spring", 60.0), ("torque_offset", 30.0))
    )
    drag, elsewhere = (
        hypothesis(rows, "quadratic_drag", Site(0), 50.0),
        hypothesis(rows, "torque_offset", Site(1), 40.0),
    )
    part = Term(spring, (drag, elsewhere, offset)).nested_law(rows, left_out(1.0))
    assert part is not None
    assert part.own is offset
    assert [h.name for h in part.rivals] == [spring.name, drag.name, elsewhere.name]
    more = log_odds(part.rivals[0], rows) - log_odds(offset, rows)
    assert more == pytest.approx(1.0 + prior_log_odds(effect("joint_spring"), rows.columns.robot))
    assert more < 0.0
    unlikely = replace(offset, log_evidence=1.0)
    assert Term(spring, (drag, unlikely)).nested_law(rows, left_out(1.0)) is None
    assert Term(drag, (offset,)).nested_law(rows, left_out(1.0)) is None
