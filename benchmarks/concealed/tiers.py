"""What a case of each tier is made of, before any robot is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .effects import NAMED, OUTSIDE

SIZES = (0.02, 0.04, 0.08, 0.16)
ABSORBED = (
    "rotor_inertia_of_first_joint",
    "payload_always_there",
    "spring_at_a_fixed_angle",
    "gain_of_all_torques",
    "encoder_offset_of_last_joint",
    "encoder_offset_of_vertical_first_joint",
    "base_moved",
)
_EXPECTED = {"clean": "named", "field": "named", "null": "nothing", "absorbed": "absorbed", "outside": "unexplained"}
TIERS = tuple(_EXPECTED)
# In field conditions every joint has viscous and Coulomb friction anyway.
_FIELD = tuple(e for e in NAMED if e not in ("viscous_friction", "coulomb_friction", "asymmetric_coulomb_friction"))
_KINDS: Mapping[str, tuple[str, ...]] = {
    "clean": tuple(NAMED),
    "field": _FIELD,
    "null": (),
    "absorbed": ABSORBED,
    "outside": tuple(OUTSIDE),
}


@dataclass(frozen=True)
class Conditions:
    """How a recording is made.

    Attributes:
        rates_hz: to draw from.
        background: friction on every joint beside what is concealed.
        torque_noise: standard deviation in parts of each joint's torque RMS.
        colour_s: (low, high) of the time in which torque noise forgets itself; zeros for white.
        drift: RMS of a slow drift, in parts of the torque RMS.
        encoder_bits: (low, high) a turn.
        torque_steps: (low, high) number of steps up to a joint's largest torque; zeros for none.
    """

    rates_hz: tuple[float, ...]
    background: bool
    torque_noise: float
    colour_s: tuple[float, float]
    drift: float
    encoder_bits: tuple[int, int]
    torque_steps: tuple[int, int]


CLEAN = Conditions((100.0, 200.0, 250.0, 500.0, 1000.0), False, 0.02, (0.0, 0.0), 0.0, (17, 19), (0, 0))
FIELD = Conditions((125.0,), True, 0.03, (0.008, 0.03), 0.004, (15, 15), (60, 200))


@dataclass(frozen=True)
class Plan:
    """What one case shall be.

    Attributes:
        tier, index: which one.
        expected: "named", "nothing", "absorbed" or "unexplained".
        kinds: ids of concealed effects, or of ABSORBED; the first takes its turn, others are drawn.
        sizes: of each.
        conditions: of its recordings.
    """

    tier: str
    index: int
    expected: str
    kinds: tuple[str, ...]
    sizes: tuple[float, ...]
    conditions: Conditions


def plan(tier: str, index: int, seed: int, of: int) -> Plan:
    """Return the plan of a tier's case: effects and sizes take turns, so that any number of cases is balanced.

    Args:
        tier: one of TIERS.
        index: of the case in its tier.
        seed: of the set.
        of: number of the set, development or final.
    """
    order, rng = (np.random.default_rng([seed, of, TIERS.index(tier), *more]) for more in ((0,), (1, index)))
    kinds, conditions = _KINDS[tier], CLEAN if tier == "clean" else FIELD
    if not kinds:
        return Plan(tier, index, _EXPECTED[tier], (), (), conditions)
    n = len(kinds)
    first = kinds[order.permutation(n)[index % n]]
    # Sizes shift by one from round to round, so that each effect meets all of them.
    sizes = [SIZES[(index % n + index // n) % len(SIZES)]]
    count = int(rng.choice([1, 2, 3, 4], p=[0.55, 0.25, 0.12, 0.08])) if tier == "field" else 1
    others = _others(rng, first, kinds)[: count - 1] if count > 1 else []
    sizes += [float(rng.choice(SIZES)) for _ in others]
    return Plan(tier, index, _EXPECTED[tier], (first, *others), tuple(sizes), conditions)


def _others(rng: np.random.Generator, first: str, kinds: tuple[str, ...]) -> list[str]:
    """Return further kinds in random order, with at most one of the whole robot among all."""
    chosen = [first]
    for kind in rng.permutation([k for k in kinds if k != first]).tolist():
        if not (NAMED[kind].whole_robot and any(NAMED[k].whole_robot for k in chosen)):
            chosen.append(kind)
    return chosen[1:]
