"""Effects that a user asks for by name, and their places on a robot.

EFFECT                              at all its places
EFFECT@PLACE                        PLACE as in ``Site.name``: joint3, joint3_joint1, link5, robot
EFFECT@PLACE@RECORDING[=FROM:TO]    for effects that act for a time only, [s] from the recording's start
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torchrbd.effects.base import Effect
from torchrbd.effects.registry import effect
from torchrbd.effects.sites import Site, Window
from torchrbd.errors import OptionError, closest
from torchrbd.robot import RobotModel

_SOME_TIME = Window("")


@dataclass(frozen=True)
class RequestedEffect:
    """An effect, and its place and window if the user gives them."""

    effect: Effect
    place: str | None = None
    window: Window | None = None

    @classmethod
    def parse(cls, text: str) -> RequestedEffect:
        """Read an effect in the syntax of the module's docstring.

        Raises:
            OptionError: an unknown effect, or an invalid window of time.
        """
        name, *rest = text.split("@", 2)
        if not all(rest):
            raise OptionError(f"effect '{text}': expected EFFECT, EFFECT@PLACE or EFFECT@PLACE@RECORDING=FROM:TO")
        return cls(effect(name), rest[0] if rest else None, _window(rest[1], text) if len(rest) > 1 else None)

    def sites(self, robot: RobotModel, windows: Sequence[Window]) -> tuple[Site, ...]:
        """Return the requested sites.

        Args:
            robot: the robot.
            windows: windows of time that were given for this or other effects.

        Raises:
            OptionError: the effect cannot act there.
        """
        name, always = self.effect.id, self.effect.sites(robot)
        sites = always if always and self.window is None else self.effect.sites(robot, windows)
        if not sites and not self.effect.sites(robot, (_SOME_TIME,)):
            raise OptionError(f"'{name}' has no place on robot '{robot.name}'")
        if self.place is None:
            return sites
        if not sites:
            raise OptionError(f"'{name}' acts for a time only; give it as {name}@{self.place}@RECORDING=FROM:TO")
        places = tuple(dict.fromkeys(site.name(robot) for site in sites))
        if self.place not in places:
            hints = closest(self.place, places), f"its places are: {', '.join(places) or 'none'}"
            raise OptionError(
                f"'{name}' has no place '{self.place}' on robot '{robot.name}'; {' '.join(filter(None, hints))}"
            )
        found = tuple(s for s in sites if s.name(robot) == self.place and self.window in (None, s.window))
        if not found:
            raise OptionError(f"'{name}' acts all the time; give it as {name}@{self.place}")
        return found


def _window(text: str, whole: str) -> Window:
    recording, requested, span = text.partition("=")
    try:
        start, end = span.split(":") if requested else ("", "")
        window = Window(recording, float(start or -math.inf), float(end or math.inf))
    except ValueError:
        raise OptionError(f"effect '{whole}': expected FROM:TO in seconds after '{recording}=', e.g. 2:30") from None
    if not window.start_s < window.end_s:
        raise OptionError(f"effect '{whole}': the end must come after the start")
    return window


def requested_sites(
    requested: Sequence[RequestedEffect], robot: RobotModel, recordings: Sequence[str]
) -> tuple[dict[str, tuple[Site, ...]], tuple[Window, ...]]:
    """Return the sites of requested effects by the effects' ids, and all windows of time among them.

    Args:
        requested: the effects.
        robot: the robot.
        recordings: their names.

    Raises:
        OptionError: a place or a recording that does not exist.
    """
    windows = tuple(dict.fromkeys(one.window for one in requested if one.window is not None))
    for window in windows:
        if window.recording not in recordings:
            raise OptionError(
                f"effect in recording '{window.recording}', which is none here; there are: {', '.join(recordings)}"
            )
    found: dict[str, dict[Site, None]] = {}
    for one in requested:
        found.setdefault(one.effect.id, {}).update(dict.fromkeys(one.sites(robot, windows)))
    return {name: tuple(sites) for name, sites in found.items()}, windows
