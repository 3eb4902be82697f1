"""YAML of plain data only, in which every key is unique and has a line number.

content = strict_yaml(text) content["joints"]["elbow"], line_of(content, ("joints", "elbow"))
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import yaml
from yaml.composer import ComposerError
from yaml.constructor import ConstructorError

# Largest file that people write by hand [bytes].
_LARGEST = 1 << 20


class Table(dict[Any, Any]):
    """A mapping with the line number of each of its keys, from 1."""

    lines: dict[Any, int]


class Row(list[Any]):
    """A list with the line number of each of its entries, from 1."""

    lines: dict[Any, int]


class _Loader(yaml.SafeLoader):
    """Loads numbers, text, lists and mappings only."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Table:
        seen: set[str] = set()
        for key, _ in node.value:
            if key.value in seen:
                raise ConstructorError(None, None, f"the key '{key.value}' stands twice; leave one out", key.start_mark)
            seen.add(str(key.value))
        found = Table(super().construct_mapping(node, deep))
        # Merge keys and the like have more nodes than keys; a key that is not found has no line.
        marks = {self.construct_object(key, deep=True): key.start_mark.line + 1 for key, _ in node.value}
        found.lines = {key: marks[key] for key in found if key in marks}
        return found

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Reject aliases: a few lines of them can expand to more than the memory holds."""
        if self.check_event(yaml.AliasEvent):
            raise ComposerError(
                None, None, "'*' before a word repeats another part, which is not allowed; put it in quotes or write "
                "the part out", self.peek_event().start_mark,
            )  # fmt: skip
        return super().compose_node(parent, index)


def _table(loader: _Loader, node: yaml.MappingNode) -> Table:
    return loader.construct_mapping(node, deep=True)


def _row(loader: _Loader, node: yaml.SequenceNode) -> Row:
    found = Row(loader.construct_sequence(node, deep=True))
    found.lines = {k: one.start_mark.line + 1 for k, one in enumerate(node.value)}
    return found


_Loader.add_constructor("tag:yaml.org,2002:map", _table)
_Loader.add_constructor("tag:yaml.org,2002:seq", _row)


def strict_yaml(text: str, *, largest: int = _LARGEST) -> Any:
    """Return the content of YAML: mappings are ``Table``, lists are ``Row``.

    Args:
        text: the YAML.
        largest: largest number of characters; programs may write longer files than people.

    Raises:
        yaml.YAMLError: it is not YAML, has a key twice, has an alias, or is too long.
    """
    if len(text) > largest:
        raise yaml.YAMLError(f"is {len(text)} characters long; expected a short file, at most {largest}")
    try:
        return yaml.load(text, _Loader)
    except RecursionError:
        raise yaml.YAMLError("is nested too deeply") from None


def line_of(content: Any, keys: Sequence[Any]) -> int | None:
    """Return the line of the last of these nested keys that exists; None if none does."""
    found = None
    for key in keys:
        found = getattr(content, "lines", {}).get(key, found)
        try:
            content = content[key]
        except (KeyError, IndexError, TypeError):
            break
    return found
