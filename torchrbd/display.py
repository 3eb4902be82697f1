"""How objects are shown: in a line or two at a prompt, as a card in a notebook.

The rooms that hold results come before the one that has the words of the cards.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, ClassVar

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


class Stated:
    """A result that a sentence or two can say.

    Class attributes:
        in_words: returns the sentences of a result. ``torchrbd/__init__.py``, which knows all rooms, sets it.
    """

    in_words: ClassVar[Callable[[object], str]]

    @property
    def statement(self) -> str:
        """What the result says, in sentences for a person."""
        return type(self).in_words(self)


@dataclass(frozen=True)
class Remark(Stated):
    """Something that a user should know of the input or of a result.

    Attributes:
        kind: which remark; ``report/text/remarks.py`` has its words.
        values: what it is about: names, numbers in SI units.
    """

    kind: str
    values: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return self.statement
