"""Display of objects: one or two lines at a prompt, a card in a notebook.

Result packages are imported before the report, which has the words and cards: they are set from outside.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

# Largest number of names in a line, and of letters in one value.
_MOST_NAMES, _MOST_LETTERS = 5, 60


def brief(thing: object, **parts: object) -> str:
    """Return the ``repr`` of an object: its class, and parts by name, in one line."""
    return f"{type(thing).__name__}({', '.join(f'{name}={_shown(part)}' for name, part in parts.items())})"


def few(names: Iterable[str]) -> list[str]:
    """Return the first names of many, and the number of the others."""
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
        card: returns the HTML of a result. ``torchrbd/__init__.py`` sets it.
    """

    card: ClassVar[Callable[[object], str]]

    def _repr_html_(self) -> str:
        return type(self).card(self)


class Stated:
    """A result that can be stated in a sentence or two.

    Class attributes:
        in_words: returns the sentences of a result. ``torchrbd/__init__.py`` sets it.
    """

    in_words: ClassVar[Callable[[object], str]]

    @property
    def statement(self) -> str:
        """The result in sentences."""
        return type(self).in_words(self)


@dataclass(frozen=True)
class Remark(Stated):
    """A fact about the input or a result that a user should know.

    Attributes:
        kind: key of its words in ``report/text/remarks.py``.
        values: for the words: names, numbers in SI units.
        recording: the one that it is about, if it stands among remarks on several.
    """

    kind: str
    values: dict[str, Any] = field(default_factory=dict)
    recording: str = ""

    def of(self, recording: str) -> Remark:
        """Return the same with the name of its recording."""
        return replace(self, recording=recording)

    def __str__(self) -> str:
        return self.statement
