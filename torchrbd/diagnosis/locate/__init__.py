"""Locate before naming: at which joint or link, when, and in which region a model and the robot differ."""

from torchrbd.diagnosis.locate.locate import locate, locate_rows, nameless
from torchrbd.diagnosis.locate.rows import Rows, read_rows

__all__ = ["Rows", "locate", "locate_rows", "nameless", "read_rows"]
