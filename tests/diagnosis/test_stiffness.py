"""A stiffness is one over a compliance: a value with an interval where that is known, a bound where it may be zero."""

import math

import pytest

from torchrbd.diagnosis.explain import reciprocal
from torchrbd.diagnosis.results import Quantity
from torchrbd.report.text.names import value

UNIT = "N m/rad"


def stiffness(compliance: float, std: float) -> Quantity:
    """Return it as the delta method has it."""
    return Quantity(1.0 / compliance, std / compliance**2, UNIT)


def test_a_compliance_that_is_told_from_zero_is_a_stiffness_with_its_interval() -> None:
    known = stiffness(1e-4, 1e-5)
    assert reciprocal(known) == known
    assert value(known) == "10000 ± 2000 N m/rad"


@pytest.mark.parametrize("compliance", [2.4e-8, 1e-12, -3e-7])
def test_a_compliance_that_may_be_zero_is_a_least_stiffness(compliance: float) -> None:
    bound = reciprocal(stiffness(compliance, 5e-7))
    assert math.isnan(bound.value)
    assert math.isnan(bound.std)
    assert bound.at_least == pytest.approx(1.0 / (max(compliance, 0.0) + 1.645 * 5e-7))
    assert value(bound).startswith("above 1.")
    assert value(bound).endswith(UNIT)
    assert "±" not in value(bound)
