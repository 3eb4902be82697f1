"""What a comparison of a fleet takes and returns."""

from __future__ import annotations

from dataclasses import dataclass

from torchrbd.comparison.reading import Inertia
from torchrbd.comparison.results import Difference, Load
from torchrbd.diagnosis.results import Quantity
from torchrbd.display import Stated

UNFINISHED = "unfinished"
"""Verdict of a robot that an interrupt has left."""


@dataclass(frozen=True)
class Member:
    """One robot of a fleet, identified.

    Attributes:
        name: in the fleet.
        robot: name in its URDF.
        verdict: of its identification.
        nmse: mean over the joints of the last model, held out.
        inertia: its base parameters.
        bodies: owners of the inertial parameters.
        terms: coefficients of friction and other terms, by name.
        doubts: of its identification.
    """

    name: str
    robot: str
    verdict: str
    nmse: float
    inertia: Inertia
    bodies: tuple[str, ...]
    terms: dict[str, Quantity]
    doubts: tuple[str, ...]


@dataclass(frozen=True)
class Deviation:
    """A parameter in which a robot differs from its sisters.

    Attributes:
        parameter: its name.
        kind: "inertia", or the parameter of a term, such as "viscous".
        value: the robot's.
        median: the fleet's.
        spread: standard deviation of what would be no difference, see ``sisters.py``.
        z: (value - median) / spread.
        chance: N P p(z): how many such differences a fleet of equal robots would have.
    """

    parameter: str
    kind: str
    value: Quantity
    median: float
    spread: float
    z: float
    chance: float


@dataclass(frozen=True)
class MemberResult(Stated):
    """What became of one robot.

    Attributes:
        name: in the fleet.
        verdict: of its identification; "failed" or "unfinished" where there is none.
        nmse: held out; NaN where there is none.
        error: why there is none; empty if there is one.
        sisters: how many robots it was compared with, itself among them.
        deviations: where it differs from them, the most certain first.
        load: a load that explains what is different in its inertia, or None.
        changes: parameters that changed since the earlier time, by name; None without an earlier time.
        doubts: of its identification.
        not_compared: why something was not compared with the earlier time, see ``fleet/earlier.py``; empty if all was.
        not_compared_detail: the name or message that belongs to it.
    """

    name: str
    verdict: str
    nmse: float
    error: str
    sisters: int
    deviations: tuple[Deviation, ...]
    load: Load | None
    changes: dict[str, Difference] | None
    doubts: tuple[str, ...]
    not_compared: str = ""
    not_compared_detail: str = ""

    @property
    def is_notable(self) -> bool:
        """Whether there is something to look at: it differs, has changed or has failed."""
        return self.verdict != UNFINISHED and bool(self.deviations or self.changes or self.error)


@dataclass(frozen=True)
class FleetComparison(Stated):
    """A fleet: who differs, what changed.

    Attributes:
        members: in the order given.
        earlier: what the earlier time is called; empty without one.
    """

    members: tuple[MemberResult, ...]
    earlier: str

    @property
    def finished(self) -> bool:
        """Whether no robot was left by an interrupt."""
        return all(one.verdict != UNFINISHED for one in self.members)
