"""YAML of plain data alone, in which every key stands once."""

from __future__ import annotations

from typing import Any

import yaml
from yaml.composer import ComposerError
from yaml.constructor import ConstructorError

# Of a file that people write by hand [bytes].
_LARGEST = 1 << 20


class _Loader(yaml.SafeLoader):
    """Makes numbers, text, lists and mappings and nothing else."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if key.value in seen:
                raise ConstructorError(None, None, f"the key '{key.value}' stands twice; leave one out", key.start_mark)
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Refuse aliases: a few lines of them can stand for more than any memory holds."""
        if self.check_event(yaml.AliasEvent):
            raise ComposerError(
                None, None, "'*' before a word repeats another part, which is not allowed; put it in quotes or write "
                "the part out", self.peek_event().start_mark,
            )  # fmt: skip
        return super().compose_node(parent, index)


def strict_yaml(text: str, *, largest: int = _LARGEST) -> Any:
    """Return what YAML holds.

    Args:
        text: the YAML.
        largest: characters that it may have; of what programs write there may be more.

    Raises:
        yaml.YAMLError: it is none, has a key twice, an alias, or is longer than a person writes.
    """
    if len(text) > largest:
        raise yaml.YAMLError(f"is {len(text)} characters long; expected a short file, at most {largest}")
    try:
        return yaml.load(text, _Loader)
    except RecursionError:
        raise yaml.YAMLError("is nested too deeply") from None
