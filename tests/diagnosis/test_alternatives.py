"""How many times as probable a rival is, from left-out errors."""

from __future__ import annotations

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import Motion, record

from torchrbd.diagnosis.alternatives import LARGEST_PROBABILITY, Weighed, rival_odds, weigh
from torchrbd.diagnosis.rows.gain import Gain, gain
from torchrbd.diagnosis.rows.regression import fitted
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.search.options import BACKGROUND
from torchrbd.diagnosis.search.select import Search
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.physics import Site, effect
from torchrbd.robot import RobotModel

URDF = random_urdf(5, 3, kinds=("revolute",), branching=0.0, massless=0.0)
BLOCKS, COUNTS = 20, np.array([2000])


def errors(better: float, scatter: float) -> np.ndarray:
    """Return left-out errors (B, 1) that are lower than one by a part, scattered over the blocks."""
    return 1.0 - better + scatter * np.random.default_rng(3).standard_normal((BLOCKS, 1))


def test_a_lead_that_the_blocks_support_counts_for_both_alike() -> None:
    ahead, behind = errors(0.02, 0.001), errors(0.0, 0.0)
    assert gain(behind, ahead, COUNTS).t > 5
    assert rival_odds(ahead, behind, COUNTS, 0.0) > 1e5
    assert rival_odds(behind, ahead, COUNTS, 0.0) < 1e-5


@pytest.mark.parametrize("freedom", [0.0, 3.0])
def test_a_lead_of_chance_decides_for_neither(freedom: float) -> None:
    ahead, behind = errors(0.02, 0.4), errors(0.0, 0.0)
    lead = gain(behind, ahead, COUNTS)
    assert lead.total > 10
    assert lead.t < 1
    forward, backward = (rival_odds(a, b, COUNTS, freedom) for a, b in ((ahead, behind), (behind, ahead)))
    assert np.exp(-freedom) < forward < 2 * np.exp(-freedom)
    assert backward == pytest.approx(np.exp(-2 * freedom) / forward)


def test_plain_friction_is_a_rival_of_what_contains_it() -> None:
    def extra(motion: Motion) -> np.ndarray:
        qd = motion.qd[:, 1]
        return (np.sign(qd) * (0.5 + 0.5 * np.exp(-((qd / 0.3) ** 2))))[:, None] * (np.arange(3) == 1)

    recording = record(URDF, 5, duration_s=20.0, rate_hz=125.0, extra=extra)
    prepared = prepare(RobotModel.from_urdf(URDF), [recording], Settings(), ())
    names = (*BACKGROUND, "stribeck_friction", "time_delay", "quadratic_drag")
    search = Search(read_samples(prepared, prepared.fit().pi), [effect(n) for n in names], prepared.prior)
    (found,) = (one for one in weigh(search, search.run()) if one.term.effect.id == "stribeck_friction")
    plain = [r for r in found.rivals if r.candidate.effect.id == "coulomb_friction"]
    assert len(plain) == 1
    assert plain[0].odds < 1e-6
    assert found.none + sum(r.odds for r in found.rivals) < 0.01


def test_the_less_a_name_gains_the_likelier_it_imitates_something() -> None:
    columns = prepare(RobotModel.from_urdf(URDF), [record(URDF, 5, duration_s=10.0)], Settings(), ()).columns

    def probability(name: str, total: float) -> float:
        term = columns.candidate(effect(name), Site(1), {})
        return Weighed(term, Gain(total, 0.1 * total, 0.8 * total), 0.0, ()).probability

    assert [probability("joint_spring", total) for total in (20.0, 40.0, 180.0)] == pytest.approx([1 / 2, 2 / 3, 0.9])
    assert probability("coulomb_friction", 20.0) == LARGEST_PROBABILITY


def test_a_loss_of_chance_makes_no_term_certainly_nothing() -> None:
    urdf = random_urdf(7, 2, kinds=("revolute",), branching=0.0, massless=0.0)

    def wandering(motion: Motion) -> np.ndarray:
        steps = np.random.default_rng(7).standard_normal(motion.q.shape)
        return 2.0 * np.sin(2.0 * np.pi * 0.05 * np.cumsum(steps, axis=0))

    recording = record(urdf, 7, duration_s=10.0, rate_hz=125.0, extra=wandering)
    prepared = prepare(RobotModel.from_urdf(urdf), [recording], Settings(), ())
    samples = read_samples(prepared, prepared.fit().pi)
    terms = [samples.columns.candidate(effect(name), Site(j), {}) for j in range(2) for name in BACKGROUND]
    search = Search(samples, [effect(name) for name in BACKGROUND], prepared.prior)
    found = weigh(search, fitted(samples, prepared.prior, terms))
    assert min(one.worth.total for one in found) < -10
    assert all(one.probability > 0.05 for one in found if abs(one.worth.t) < 2)
