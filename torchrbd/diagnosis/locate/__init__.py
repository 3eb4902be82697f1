"""Locate before naming: at which joint or link, when, and in which region a model and the robot differ."""

from torchrbd.diagnosis.locate.hum import hums
from torchrbd.diagnosis.locate.locate import locate
from torchrbd.diagnosis.locate.shock import shock_notes, shocks
from torchrbd.diagnosis.locate.stretches import stretches
from torchrbd.diagnosis.locate.wander import wanders

__all__ = ["hums", "locate", "shock_notes", "shocks", "stretches", "wanders"]
