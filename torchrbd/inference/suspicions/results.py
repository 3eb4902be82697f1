"""What is suspected of a table, and what was looked for."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Suspicion:
    """One thing that a table seems to mean instead of what it says.

    Attributes:
        kind: "degrees", "radians", "millimetres", "time unit", "torque sign", "position sign", "direction",
            "swapped torques", "swapped positions", "swapped joints", "gravity", "torque gain", "speed", "late torque",
            "clipped torque", "variant".
        joints: where; none if it concerns the whole table.
        log_odds: against a table that means what it says, in nats.
        times: by which factor the squared error on time left out of the fit falls, the geometric mean over the joints
            that it concerns; NaN where something else than the error tells it.
        statement: the evidence in a sentence.
        remedy: the option or the mapping entry that corrects it.
        settles: whether nothing can be said of the robot before it is settled.
        spoils: whether fits are to be doubted where it is so; those that allow for it note it.
        alternatives: what these recordings cannot tell it from, in words.
    """

    kind: str
    joints: tuple[str, ...]
    log_odds: float
    times: float
    statement: str
    remedy: str
    settles: bool = True
    spoils: bool = True
    alternatives: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """Return evidence and remedy in one text."""
        return f"{self.statement}: {self.remedy}"


@dataclass(frozen=True)
class Suspicions:
    """All that was suspected.

    Attributes:
        found: the first is likeliest; each is told beside those before it.
        tested: what was looked for, in words.
    """

    found: tuple[Suspicion, ...] = ()
    tested: tuple[str, ...] = ()

    @property
    def settles(self) -> bool:
        """Say whether nothing can be said of the robot before the input has been looked at."""
        return any(one.settles for one in self.found)


NO_SUSPICIONS = Suspicions()
"""Of a table that was not looked at."""
