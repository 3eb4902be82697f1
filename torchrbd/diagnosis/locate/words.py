"""A location in a sentence."""

from __future__ import annotations

from torchrbd.diagnosis.results import Attack, Where
from torchrbd.diagnosis.words import joined, number

WHAT = {
    "level": "a torque",
    "friction": "friction",
    "load": "a torque like that of a load",
    "payload": "a load",
    "force": "a force",
}


def sentence(
    joints: tuple[str, ...],
    links: tuple[str, ...],
    where: Where,
    depends_on: tuple[str, ...],
    form: str,
    course: str,
    rms: float,
    unit: str,
    attack: Attack | None,
) -> str:
    """Say what differs, where, when and how much."""
    what = WHAT[form].replace("torque", "force") if unit == "N" and form == "level" else WHAT[form]
    text = f"{joints[0]}: {what} of {number(rms)} {unit} RMS is not explained"
    if links and attack is not None:
        size = sum(f * f for f in attack.force) ** 0.5
        text = f"{joined(links)}: {what} of {number(size)} N"
        if max(attack.point_std) < 0.3:
            text += f" at ({', '.join(number(x) for x in attack.point)}) m of its frame"
        text += f" would explain what is left at {joined(joints)}"
    if course == "slow":
        text += "; it changes slowly with time"
    elif depends_on and depends_on != ("t",):
        text += f"; it depends on {joined(depends_on)}"
    if where.region:
        text += ", " + joined(f"between {number(r.low)} and {number(r.high)}" for r in where.region)
    if where.time_s:
        text += ", from " + joined(f"{low:.1f} to {high:.1f} s" for low, high in where.time_s)
    return text + (f", in {joined(where.recordings)}." if where.recordings else ".")
