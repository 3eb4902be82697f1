"""Dataclasses from JSON: what was written from them, checked against their types."""

from __future__ import annotations

import json
import math
import types
import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from torchrbd.errors import InputError


def rebuilt(kind: Any, value: Any) -> Any:
    """Return what JSON says as the dataclasses, tuples and numbers that it was written from; null is NaN for a number.

    Raises:
        TypeError, ValueError: it says something else.
    """
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if isinstance(kind, type) and is_dataclass(kind):
        if not isinstance(value, Mapping):
            raise TypeError(f"expected a {kind.__name__}, got {value!r}")
        types_of = typing.get_type_hints(kind)
        return typing.cast(Any, kind)(
            **{f.name: rebuilt(types_of[f.name], value[f.name]) for f in fields(kind) if f.name in value}
        )
    if origin is typing.Literal:
        if value not in inner:
            raise ValueError(f"expected one of {', '.join(map(str, inner))}, got {value!r}")
        return value
    if origin in (types.UnionType, typing.Union):
        (other,) = (one for one in inner if one is not type(None))
        return None if value is None else rebuilt(other, value)
    if origin is tuple:
        each = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        return tuple(rebuilt(one, v) for one, v in zip(each, value, strict=True))
    if origin is dict:
        return {str(key): rebuilt(inner[1], v) for key, v in value.items()}
    if kind is typing.Any:
        return value
    if kind is float:
        return math.nan if value is None else float(value)
    return kind(value)


def read_json(file: Path, command: str) -> dict[str, Any]:
    """Return what a file of results says.

    Args:
        file: whose.
        command: that writes it.

    Raises:
        InputError: no such file, or not a mapping in JSON.
    """
    again = f"{command} the recordings again"
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"{file}: cannot be read ({error.strerror}); give the folder that "
            f"'torchrbd {command} -o' or torchrbd.write_results wrote, "
            f"or the {file.name} in it"
        ) from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: is not JSON ({error}); {again}") from None
    if not isinstance(content, dict):
        raise InputError(
            f"{file}: expected what 'torchrbd {command}' writes, a mapping; got a {type(content).__name__}"
        )
    return content


class Unsaved:
    """A part of a result that its files do not hold: whoever looks into it gets an error that says so."""

    def __init__(self, place: Path, what: str, remedy: str) -> None:
        """Stand in for ``what``, e.g. "torques against time", of the results in the folder ``place``."""
        self._words = f"{place}: the files of a result do not hold {what}; {remedy}"

    def __getattr__(self, name: str) -> Any:
        # Copying, pickling and notebooks look for names that nobody has to have.
        if name.startswith("_"):
            raise AttributeError(name)
        raise InputError(self._words)

    def __repr__(self) -> str:
        return f"<{self._words}>"
