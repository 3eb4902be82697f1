"""Results in a notebook: the rooms that hold them come before the one that has the words for a person."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar


class Displayed:
    """A result that notebooks show as a card.

    Class attributes:
        card: returns the HTML of a result. ``torchrbd/__init__.py``, which knows all rooms, sets it.
    """

    card: ClassVar[Callable[[object], str]]

    def _repr_html_(self) -> str:
        return type(self).card(self)
