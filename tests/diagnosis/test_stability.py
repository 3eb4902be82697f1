"""How often repeated searches find a finding again."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from likelihood.fits import at_joint, fitted

import torchrbd
from torchrbd.diagnosis.outcome import SearchOutcome
from torchrbd.diagnosis.results import Elpd, Finding, Where
from torchrbd.diagnosis.search import search_effects
from torchrbd.diagnosis.stability import reweight, with_stability
from torchrbd.effects import effect

EFFECTS = [effect(name) for name in ("viscous_friction", "rotor_inertia", "joint_spring", "torque_offset")]
PULL_S = (6.2, 9.1)
WORTH = Elpd(10.0, 1.0, 10.0, 0.5, 0.5)


@pytest.fixture(scope="module")
def found() -> SearchOutcome:
    def torque(m):
        return at_joint(1, lambda m: 0.05 * m.qdd[:, 1])(m) + at_joint(
            0, lambda m: 0.8 * ((m.t >= PULL_S[0]) & (m.t < PULL_S[1]))
        )(m)

    return search_effects(fitted(torque), EFFECTS, lambda *_: None)


def finding(found: SearchOutcome, e: str, joint: int, where: Where | None = None) -> Finding:
    name = found.rows.columns.robot.joint_names[joint]
    return Finding(e, (name,), (), 0.9, 9.0, {}, where or Where(), (), {}, {}, elpd=WORTH)


def test_what_is_there_is_found_again_and_what_is_not_is_not(found: SearchOutcome) -> None:
    (recording,) = found.rows.recordings
    offset = [finding(found, "torque_offset", 0, Where((recording,), (span,))) for span in (PULL_S, (14.0, 15.0))]
    several = [
        finding(found, "rotor_inertia", 1),
        finding(found, "viscous_friction", 0),
        finding(found, "joint_spring", 1),
        finding(found, "rotor_inertia", 0),
        *offset,
        replace(finding(found, "rotor_inertia", 1), elpd=None),
    ]
    parts = list[float]()
    judged = with_stability(several, found, EFFECTS, 3, 0, parts.append)
    assert [one.stability for one in judged] == [1.0, 1.0, 0.0, 0.0, 1.0, 0.0, None]
    assert [replace(one, stability=None) for one in judged] == several
    assert parts == sorted(parts)
    assert parts[-1] == 1.0


def test_repetitions_follow_the_seed_alone(found: SearchOutcome) -> None:
    first, again, other = (reweight(found, np.random.default_rng(seed)).fit.hyper.noise[0].spread for seed in (0, 0, 1))
    assert np.array_equal(first, again)
    assert not np.allclose(first, other)


def test_weights_are_of_blocks_and_keep_the_number_of_rows(found: SearchOutcome) -> None:
    """A block of weight w counts w times: its whitened squares are those of before times w."""
    before, after = found.discrepancy.fit, reweight(found, np.random.default_rng(0)).fit
    block = np.unique(found.rows.block, return_inverse=True)[1]
    weight = (before.hyper.noise[0].spread / after.hyper.noise[0].spread) ** 2
    first = weight[np.unique(block, return_index=True)[1]]
    assert weight == pytest.approx(first[block])
    assert first.mean() == pytest.approx(1.0)
    assert len(set(first)) == len(first)
    at = before.index[0]
    assert after.gaussian.blocks[0].y == pytest.approx(before.gaussian.blocks[0].y * np.sqrt(weight[at]))


@pytest.mark.parametrize("count", [-1, 2.5, True, "many", math.nan])
def test_numbers_of_repetitions_that_are_none_are_refused(count: object) -> None:
    demo = Path(torchrbd.__file__).parent / "demo"
    with pytest.raises(torchrbd.OptionError, match=r"stability is .*expected a number of repetitions"):
        torchrbd.diagnose(demo / "arm.urdf", [demo / "fit.parquet"], stability=count)  # type: ignore[arg-type]
