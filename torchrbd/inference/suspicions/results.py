"""What is suspected of a table, and what was looked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from torchrbd.display import Stated


@dataclass(frozen=True)
class Meaning:
    """What the columns of a table may mean.

    Attributes:
        kind: as of a ``Suspicion``.
        joints: whose columns; none for all of them, or where it concerns time or gravity.
        unit: that is meant, for a kind that is about one.
        gravity: in the base's axes [m/s^2], for kind "gravity".
    """

    kind: str
    joints: tuple[str, ...] = ()
    unit: str = ""
    gravity: tuple[float, ...] = ()


@dataclass(frozen=True)
class Suspicion(Stated):
    """One thing that a table seems to mean instead of what it says; its ``statement`` is the evidence.

    Attributes:
        kind: "degrees", "radians", "millimetres", "time unit", "torque sign", "position sign", "direction",
            "swapped torques", "swapped positions", "swapped joints", "gravity", "torque gain", "speed", "late torque",
            "clipped torque", "variant", "set-points in degrees", "set-points of the opposite sign",
            "swapped set-points".
        joints: where; none if it concerns the whole table.
        log_odds: against a table that means what it says, in nats.
        times: by which factor the squared error on time left out of the fit falls, the geometric mean over the joints
            that it concerns; NaN where something else than the error shows it.
        meaning: what the columns would mean.
        sizes: numbers of that kind by joint or name: gains of torques, speeds over their limits, rates as read and as
            meant [Hz], samples and delay [s] with its std, the limit of a torque [``meaning.unit``], its share of the
            rows and what the motion needs beyond it, lengths of links and the URDF's [m].
        names: names that belong to it: the column, or the parent link by joint.
        mapping: the entry of a mapping that corrects it; empty where none does.
        settles: whether nothing can be said of the robot before it is settled.
        spoils: whether fits are to be doubted where it is so; those that allow for it note it.
        alternatives: what these recordings cannot distinguish it from.
    """

    kind: str
    joints: tuple[str, ...]
    log_odds: float
    times: float
    meaning: Meaning
    sizes: dict[str, float] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    mapping: dict[str, Any] = field(default_factory=dict)
    settles: bool = True
    spoils: bool = True
    alternatives: tuple[Meaning, ...] = ()

    @property
    def remedy(self) -> str:
        """What to do: the option or the mapping entry that corrects it."""
        return Remedy(self).statement

    @property
    def words(self) -> str:
        """Evidence and remedy in one text."""
        remedy = self.remedy
        return f"{self.statement}. {remedy[:1].upper()}{remedy[1:]}"


@dataclass(frozen=True)
class Remedy(Stated):
    """What to do about a suspicion."""

    suspicion: Suspicion


@dataclass(frozen=True)
class Suspicions:
    """All that was suspected.

    Attributes:
        found: the first is likeliest; each is given those before it.
        tested: kinds of what was looked for.
    """

    found: tuple[Suspicion, ...] = ()
    tested: tuple[str, ...] = ()

    @property
    def settles(self) -> bool:
        """Say whether nothing can be said of the robot before the input has been looked at."""
        return any(one.settles for one in self.found)


NO_SUSPICIONS = Suspicions()
"""Of a table that was not looked at."""
