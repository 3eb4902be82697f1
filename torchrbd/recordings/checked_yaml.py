"""YAML files, checked with a pydantic model: errors name file, line, key and remedy."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from torchrbd.errors import InputError, closest
from torchrbd.recordings.strict_yaml import line_of, strict_yaml

Model = TypeVar("Model", bound=BaseModel)
Loc = tuple[Any, ...]


class Keys(BaseModel):
    """Base class of mappings with known keys only; subclasses define them.

    Class attributes:
        missing: by key, the message if that key is missing.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    missing: ClassVar[dict[str, str]] = {}

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, value: Any) -> Any:
        known = tuple(cls.model_fields)
        if not isinstance(value, dict):
            raise wrong(f"expected {' or '.join(known)}, got {value!r:.80}")
        for key in value:
            check_key(key, known)
        for key, words in cls.missing.items():
            if value.get(key) in (None, "", []):
                raise wrong(words)
        return value


def wrong(words: str, key: Any = None) -> PydanticCustomError:
    """Return an error with a message; ``key`` is its place below the one that is checked."""
    return PydanticCustomError("wrong", "{words}", {"words": words, "key": key})


def check_key(key: Any, known: Iterable[str] | None = None) -> None:
    """Raise an error for a key that is not text, or that is not in ``known``."""
    if not isinstance(key, str):
        raise wrong(f"the key {key!r} must be text; put it in quotes", key)
    if known is not None and key not in known:
        hint = closest(key, known)
        raise wrong(f"unknown key '{key}'{f' ({hint})' if hint else ''}; valid keys are {', '.join(known)}", key)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise wrong(f"expected a number, got {value!r:.50}")
    return float(value)


Number = Annotated[float, BeforeValidator(_number)]
"""A finite number."""


def read_yaml(path: Path, unreadable: str, kind: type[InputError], *, largest: int | None = None) -> Any:
    """Return the content of a YAML file.

    Args:
        path: of the file.
        unreadable: message, with the remedy, if the file cannot be opened; ``{reason}`` is filled in.
        kind: class of the errors.
        largest: largest number of characters.
    """
    try:
        text = path.read_text(encoding="utf-8")
        return strict_yaml(text) if largest is None else strict_yaml(text, largest=largest)
    except OSError as error:
        raise kind(f"{path}: {unreadable.format(reason=error.strerror)}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise kind(f"{path}: is not YAML in UTF-8 ({' '.join(str(error).split())})") from None


def checked(
    model: type[Model], content: Any, path: Path, kind: type[InputError], place: Callable[[Loc], str] | None = None
) -> Model:
    """Return the content of a file as a model.

    Args:
        model: the pydantic model.
        content: from ``read_yaml``.
        path: the file, named in errors.
        kind: class of the errors.
        place: function from the keys of a place to its name in messages; default: the keys joined by dots.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        loc = _there(content, first["loc"])
        context = first.get("ctx", {})
        key = context.get("key")
        line = line_of(content, loc if key is None else (*loc, key))
        words = context["words"] if first["type"] == "wrong" else _foreseen(first)
        where = (place or _dotted)(loc)
        raise kind(": ".join(filter(None, (str(path), f"line {line}" if line else "", where, words)))) from None


def _there(content: Any, loc: Loc) -> Loc:
    """Return the keys of a place without pydantic's names of the branches of a union."""
    found: list[Any] = []
    for part in loc:
        if (isinstance(content, dict) and part in content) or (isinstance(content, list) and isinstance(part, int)):
            content = content[part]
            found.append(part)
    return tuple(found)


def _foreseen(error: Any) -> str:
    """Return pydantic's message in the form of the other errors."""
    return f"{error['msg'][:1].lower()}{error['msg'][1:]}, got {error['input']!r:.50}"


def _dotted(loc: Loc) -> str:
    return ".".join(map(str, loc)) or "the file"
