"""Locate before naming: at which joint or link, when, and in which region a model and the robot differ."""

from torchrbd.diagnosis.locate.locate import locate

__all__ = ["locate"]
