"""What was considered: hypotheses given others, where estimates of friction disagree, clocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torchrbd.diagnosis.ranked import Ranked
from torchrbd.diagnosis.results import Alternative
from torchrbd.likelihood.misfit import Misfit
from torchrbd.likelihood.misspecification import MISFIT
from torchrbd.report.text.names import at, named
from torchrbd.report.text.numbers import joined, measure, number

FIRST_STEP, LAST_STEP = "First step", "Last step"
WITHOUT_EFFECTS = "given a rigid body with baseline friction"
"""What the hypotheses of the first step are compared with."""


def given_words(adopted: Sequence[Ranked]) -> str:
    """Return what the hypotheses of the last step are compared with."""
    first, *others = adopted
    return f"given the {len(adopted)} adopted effects" if others else f"given {hypothesis_title(first)}"


def hypothesis_title(one: Ranked) -> str:
    """Return a hypothesis by name and place: "payload on hand"."""
    return named(as_alternative(one)) + (at(one.joints, one.links) or " on the whole robot")


def as_alternative(one: Ranked) -> Alternative:
    """Return a hypothesis as the rival of a finding."""
    return Alternative(one.effect, one.joints, one.links, () if one.other is None else (f"q_{one.other}",))


def misfit_sentence(found: Mapping[str, Misfit]) -> str:
    """Say at which joints whitened rows and least squares disagree on friction; nothing where that was not tested."""
    wrong = [f"{joint} (p = {number(m.p_value)})" for joint, m in found.items() if m.p_value < MISFIT]
    if not wrong:
        agree = "Whitened rows and plain least squares agree on the friction of every joint."
        return agree if any(m.dof for m in found.values()) else ""
    return (
        f"Whitened rows and plain least squares disagree on the friction of {joined(wrong)}. "
        "Another law than viscous plus Coulomb friction acts there. The values shown are those of least squares."
    )


def clock_words(delay_s: float, std_s: float) -> str:
    """Say by what the torque is later than the motion [s], or earlier, ± 95 %."""
    return f"{measure(1e3 * abs(delay_s), 1.96e3 * std_s)} ms {'earlier' if delay_s < 0 else 'later'}"
