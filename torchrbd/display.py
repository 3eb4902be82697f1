"""How objects are shown: in a line or two at a prompt, as a card in a notebook.

The rooms that hold results come before the one that has the words of the cards.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import ClassVar

# Names that a line shows, and letters of one value.
_MOST_NAMES, _MOST_LETTERS = 5, 60


def brief(thing: object, **parts: object) -> str:
    """Return the ``repr`` of an object: its class, and parts by name, in one line."""
    return f"{type(thing).__name__}({', '.join(f'{name}={_shown(part)}' for name, part in parts.items())})"


def few(names: Iterable[str]) -> list[str]:
    """Return the first names of many, and how many more there are."""
    every = list(names)
    more = [f"{len(every) - _MOST_NAMES} more"] if len(every) > _MOST_NAMES else []
    return [*every[:_MOST_NAMES], *more]


def _shown(part: object) -> str:
    if isinstance(part, float):
        return f"{part:.4g}"
    if isinstance(part, list):
        return f"[{', '.join(map(_shown, part))}]"
    words = " ".join(repr(part).split())
    return words if len(words) <= _MOST_LETTERS else f"{words[: _MOST_LETTERS - 3]}..."


class Displayed:
    """A result that notebooks show as a card.

    Class attributes:
        card: returns the HTML of a result. ``torchrbd/__init__.py``, which knows all rooms, sets it.
    """

    card: ClassVar[Callable[[object], str]]

    def _repr_html_(self) -> str:
        return type(self).card(self)
