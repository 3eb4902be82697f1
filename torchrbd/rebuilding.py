"""Dataclasses from JSON: what was written from them, checked against their types."""

from __future__ import annotations

import math
import types
import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any


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
    if origin in (types.UnionType, typing.Union):
        (other,) = (one for one in inner if one is not type(None))
        return None if value is None else rebuilt(other, value)
    if origin is tuple:
        each = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        return tuple(rebuilt(one, v) for one, v in zip(each, value, strict=True))
    if origin is dict:
        return {str(key): rebuilt(inner[1], v) for key, v in value.items()}
    if kind is float:
        return math.nan if value is None else float(value)
    return kind(value)
