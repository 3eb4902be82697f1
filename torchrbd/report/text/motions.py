"""Motion to record next: what identifies a parameter, and what a designed motion leaves open."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from torchrbd.inference.posterior.experiments import SECONDS
from torchrbd.inference.posterior.identifiability import Identifiability
from torchrbd.report.text.numbers import joined


def _motion(
    kind: str, joint: str = "", unit: str = "", speed: float = 0.0, acceleration: float = 0.0,
    varied: Sequence[str] = (), others: int = 0,
) -> str:  # fmt: skip
    """Say what to do; ``others`` is the number of joints that do not move."""
    if kind == "all":
        return "move all joints at once, at changing speed"
    said = {
        "slow": f"move {joint} slowly through its range",
        "accelerate": f"accelerate {joint} back and forth (to about {acceleration:.2g} {unit}/s^2)",
        "fast": f"move {joint} fast (at about {speed:.2g} {unit}/s)",
    }[kind]
    if not varied:
        return said
    postures = "the other joints" if 1 < len(varied) == others else joined(varied)
    return f"{said} in several postures of {postures}"


def identifiability_statement(one: Identifiability) -> str:
    """Say what is known of one inertial parameter."""
    name = one.name
    if one.status == "held":
        return f"{name} was not fitted"
    if one.status == "not identifiable":
        return f"no motion of this robot with its base fixed identifies {name}"
    if one.status == "identified":
        return f"{name} is identified"
    if one.status == "combination":
        shortest, *others = one.combinations
        number = f"{len(others)} other combination{'s' if len(others) > 1 else ''}"
        return shortest.statement + (f", and {number} with {name}" if others else "")
    share, least, after = (f"{100 * x:.0f} %" for x in (one.prior_share, one.least_share, one.prior_share_after))
    said = f"this data does not identify {name} (prior's share {share})"
    if one.suggested is None:
        return f"{said}. At this noise no {SECONDS:.0f} s of motion would. Record longer or with less noise"
    floor = f". Less than {least} no motion can: it is identified in combination only" if one.combinations else ""
    return f"{said}. To identify it, {one.suggested}: {SECONDS:.0f} s would leave the prior a share of {after}{floor}"


def _open(one: str, other: str, log_bayes_factor: float) -> str:
    return (
        f"{one} and {other} may stay open: the expected log Bayes factor is {log_bayes_factor:.1f}. "
        "They are the same on any such motion, or other limits are needed"
    )


def _no_parameters(finding: str) -> str:
    return (
        f"{finding}: the diagnosis does not say what parameters its rivals would have, so that no motion is sought "
        "for it. Give the folder that 'torchrbd diagnose -o' wrote, or diagnose the recordings again"
    )


MOTIONS: dict[str, Callable[..., str]] = {
    "motion": _motion,
    "only combination": lambda expression: f"only {expression} is identified",
    "never identified": lambda parameters: f"no motion of this robot identifies {', '.join(parameters)}",
    "nothing open": lambda: (
        "the diagnosis leaves nothing open that a motion could decide; this one identifies the parameters"
    ),
    "rivals stay open": _open,
    "rivals without parameters": _no_parameters,
}
"""By kind of remark, what says it; without a full stop."""
