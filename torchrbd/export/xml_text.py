"""Numbers and comments as XML has them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from lxml import etree

_HYPHENS = re.compile("-(?=-)")

Value = float | tuple[float, ...] | str


def text(value: Value | Sequence[float]) -> str:
    """Return an attribute's value, its numbers in full."""
    if isinstance(value, str):
        return value
    return " ".join(repr(float(v)) for v in (value if isinstance(value, Sequence) else (value,)))


def element_text(element: str, attributes: Mapping[str, Value]) -> str:
    """Return an element as one would write it by hand."""
    named = " ".join(f'{name}="{text(value)}"' for name, value in attributes.items())
    return f"MJCF: <{element} {named}>"


def comment(words: str) -> etree._Element:
    """Return a comment; XML allows no two hyphens in one."""
    return etree.Comment(f" {_HYPHENS.sub('- ', words)} ")
