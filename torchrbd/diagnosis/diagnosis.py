"""What ``diagnose`` returns, and how it is read back from its files."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from torchrbd.diagnosis.decisions import DECISIONS, Decisions
from torchrbd.diagnosis.ranked import Ranking
from torchrbd.diagnosis.reading import read_diagnosis
from torchrbd.diagnosis.results import (
    Deflection,
    DetectionLimit,
    Finding,
    HeldOutCheck,
    Location,
    NextEffect,
    Quantity,
    Ratio,
    ResidualMap,
    Unexplained,
)
from torchrbd.display import Displayed, Stated
from torchrbd.errors import InputError
from torchrbd.inference.identification import Identification

if TYPE_CHECKING:
    import pandas

_MOST_IN_REPR = 5
_COLUMNS = [
    "effect", "joints", "links", "parameter", "value", "std", "unit", "probability", "log_evidence_gain", "statement",
]  # fmt: skip


@dataclass(frozen=True, repr=False)
class Diagnosis(Displayed, Stated):
    """Verdict, findings, and the identification they belong to; a notebook shows it as a card.

    Attributes:
        identification: the fitted model and its data.
        verdict: "consistent": the URDF as given explains the data. "parameters": a rigid body with other parameters
            does. "missing_physics": named effects are needed. "unexplained": no known effect explains a residual.
            "suspect": the recordings seem to mean something else, or
            no model predicts better than a constant. There are no findings then; ``identification.suspicions`` lists
            what was tested.
        findings: named effects: those likelier than not, then the others; in both, by the held-out error removed.
        unexplained: residuals that no known effect explains.
        locations: where models and robot differ, named or not.
        maps: the same as RMS of the residual over bins of time, position and velocity.
        detection_limits: for effects that were not found, how large they could be.
        joint_deflections: what encoders behind the gears show.
        simulated: recordings of a simulator that were used as the prediction of the URDF.
        held_out_checks: by joint, how the extended model predicts held-out torque.
        ranking: all hypotheses that were considered, by their evidence.
        not_confirmed: effects that are as likely as findings, but that cross-validation does not confirm: left-out
            blocks of the fitted time are not predicted better with them, or not by enough to be worth a name.
        held_out_ratio: torque that the extended model adds to a rigid body with baseline friction: its size on held-out
            data over that fitted. 1 if it is right, None if unknown.
        next_effect: what else is likelier than not, if anything.
        decisions: the limits that decided what is reported.
    """

    identification: Identification
    verdict: str
    findings: tuple[Finding, ...]
    unexplained: tuple[Unexplained, ...] = field(default=())
    locations: tuple[Location, ...] = field(default=())
    maps: tuple[ResidualMap, ...] = field(default=())
    detection_limits: tuple[DetectionLimit, ...] = field(default=())
    joint_deflections: tuple[Deflection, ...] = field(default=())
    simulated: tuple[str, ...] = field(default=())
    held_out_checks: tuple[HeldOutCheck, ...] = field(default=())
    ranking: Ranking | None = None
    not_confirmed: tuple[Finding, ...] = field(default=())
    held_out_ratio: Ratio | None = None
    next_effect: NextEffect | None = None
    decisions: Decisions = DECISIONS

    @property
    def finished(self) -> bool:
        """Whether the search came to its end; False if a time limit or the user ended it before."""
        return self.identification.finished

    @classmethod
    def load(cls, folder: str | Path) -> Diagnosis:
        """Read what ``torchrbd diagnose -o`` wrote.

        What the files do not hold is as ``Identification.load`` has it; ``ranking.evidence_of`` needs the recordings.

        Raises:
            InputError: a file is missing, or none of ours.
        """
        return cls(Identification.load(folder), **read_diagnosis(cls, folder))

    def findings_frame(self) -> pandas.DataFrame:
        """Return the findings as a table, a row for each parameter, in their order.

        Columns: effect, joints and links (text, ", " between names; empty for the whole robot), parameter, value, std,
        unit, probability, log_evidence_gain, statement. An effect without parameters has one row without values.

        Raises:
            InputError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise InputError(
                "findings_frame() takes the package pandas, which is not installed: pip install pandas (or torchrbd "
                "with its extra, pandas)"
            ) from None
        rows = [
            {
                "effect": f.effect,
                "joints": ", ".join(f.joints),
                "links": ", ".join(f.links),
                "parameter": name,
                "value": quantity.value,
                "std": quantity.std,
                "unit": quantity.unit,
                "probability": f.probability,
                "log_evidence_gain": f.log_evidence_gain,
                "statement": f.statement,
            }
            for f in self.findings
            for name, quantity in (f.parameters or {"": Quantity(math.nan, math.nan, "")}).items()
        ]
        return pandas.DataFrame(rows, columns=_COLUMNS)

    def __repr__(self) -> str:
        names = [f"{f.effect} at {', '.join((*f.joints, *f.links)) or 'whole robot'}" for f in self.findings]
        more = [f"{len(names) - _MOST_IN_REPR} more"] if len(names) > _MOST_IN_REPR else []
        return (
            f"Diagnosis(robot={self.identification.robot.name!r}, verdict={self.verdict!r}, "
            f"findings={[*names[:_MOST_IN_REPR], *more]}, unexplained={len(self.unexplained)})"
        )
