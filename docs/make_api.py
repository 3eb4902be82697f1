"""Write docs/api.md, the public names with their signatures and docstrings.

python docs/make_api.py            # writes it
python docs/make_api.py --check    # exits with 1 if it is not what would be written
"""

from __future__ import annotations

import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import torchrbd

PAGE = Path(__file__).with_name("api.md")
HEAD = """# Public names

Made from the docstrings by `python docs/make_api.py`; change those. All names are imported from `torchrbd` itself.
"""
_SECTION = re.compile(r"(Args|Attributes|Returns|Raises|Example|Source):(?:\s+(.*))?$")
_LISTS = "Args", "Attributes", "Raises"
_ITEM = re.compile(r"(\*{0,2}[\w.]+(?:, \w+)*): (.*)", re.DOTALL)
# Of a signature; longer, each parameter has its own line.
_LINE = 100
_LONGEST_DEFAULT = 40


def page() -> str:
    """Return the page."""
    rooms = {room: names for room, names in torchrbd._NAMES.items() if names}
    contents = [
        f"- {_first_line(import_module(f'torchrbd.{room}'))} {', '.join(f'[{n}](#{n.lower()})' for n in names)}"
        for room, names in rooms.items()
    ]
    parts = [HEAD, "\n".join(contents) + "\n"]
    for room, names in rooms.items():
        parts.append(f"## torchrbd.{room}\n")
        parts.append(f"{markdown(inspect.getdoc(import_module(f'torchrbd.{room}')) or '')}\n")
        parts += [f"{part}\n" for name in names for part in _entry(name, getattr(torchrbd, name))]
    return "\n".join(parts)


def _first_line(thing: Any) -> str:
    return _prose((inspect.getdoc(thing) or "").partition("\n")[0])


def _entry(name: str, thing: Any) -> Iterator[str]:
    """Yield heading, signature and text of a public name, then those of its methods."""
    yield f"### {name}"
    yield _code(_head(name, thing))
    yield markdown(inspect.getdoc(thing) or "")
    if not inspect.isclass(thing):
        return
    for member, found in _members(thing).items():
        yield f"#### {name}.{member}"
        function = getattr(found, "__func__", found)
        if isinstance(found, (property, cached_property)):
            yield _code(f"{name}.{member}{_returned(_getter(found))}")
            yield markdown(inspect.getdoc(found) or "")
        elif function.__name__ != member:
            yield f"The same as `{function.__name__}`."
        else:
            yield _code(signature(f"{name}.{member}" if found is not function else member, getattr(thing, member)))
            yield markdown(inspect.getdoc(found) or "")


def _head(name: str, thing: Any) -> str:
    if inspect.isclass(thing) and issubclass(thing, Exception):
        return f"class {name}({', '.join(base.__name__ for base in thing.__bases__)})"
    return f"class {signature(name, thing)}" if inspect.isclass(thing) else signature(name, thing)


def _members(thing: type) -> dict[str, Any]:
    """Return the public methods and properties of a class that are written here, those of its bases first."""
    found: dict[str, Any] = {}
    for base in reversed(thing.__mro__):
        if base.__module__.startswith("torchrbd"):
            found |= {name: member for name, member in vars(base).items() if not name.startswith("_")}
    kinds = (classmethod, property, cached_property)
    return {name: member for name, member in found.items() if inspect.isfunction(member) or isinstance(member, kinds)}


def _getter(found: property | cached_property) -> Callable[..., Any]:
    getter = found.fget if isinstance(found, property) else found.func
    assert getter is not None
    return getter


def signature(name: str, thing: Callable[..., Any]) -> str:
    """Return a call with its annotations, on one line if that is not long."""
    told = inspect.signature(thing)
    parameters: list[str] = []
    kinds = [p.kind for p in told.parameters.values()]
    for parameter in told.parameters.values():
        if parameter.name == "self" or (parameter.name.startswith("_") and inspect.isclass(thing)):
            continue
        first_named = parameter.kind is parameter.KEYWORD_ONLY and "*" not in parameters
        if first_named and parameter.VAR_POSITIONAL not in kinds:
            parameters.append("*")
        parameters.append(_parameter(parameter))
    returned = "" if inspect.isclass(thing) else _returned(thing)
    line = f"{name}({', '.join(parameters)}){returned}"
    if len(line) <= _LINE:
        return line
    return "\n".join([f"{name}(", *(f"    {parameter}," for parameter in parameters), f"){returned}"])


def _parameter(parameter: inspect.Parameter) -> str:
    stars = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
    annotation = "" if parameter.annotation is parameter.empty else f": {_type(parameter.annotation)}"
    if parameter.default is parameter.empty:
        return f"{stars}{parameter.name}{annotation}"
    default = repr(parameter.default)
    if "<" in default or len(default) > _LONGEST_DEFAULT:
        default = "..."
    return f"{parameter.name}{annotation}{' = ' if annotation else '='}{default}"


def _returned(thing: Callable[..., Any]) -> str:
    annotation = inspect.signature(thing).return_annotation
    return "" if annotation is inspect.Signature.empty else f" -> {_type(annotation)}"


def _type(annotation: Any) -> str:
    return annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)


def markdown(docstring: str) -> str:
    """Return a docstring as markdown: sections as lists, what is indented as code."""
    blocks: list[str] = []
    plain: list[str] = []
    lines = docstring.splitlines()
    while lines:
        line = lines.pop(0)
        section = _SECTION.match(line)
        if section is None:
            plain.append(line)
            continue
        body = []
        while lines and (not lines[0].strip() or lines[0].startswith(" ")):
            body.append(lines.pop(0))
        blocks += [*_blocks(plain), *_section(section[1], section[2] or "", textwrap.dedent("\n".join(body)).strip())]
        plain = []
    return "\n\n".join([*blocks, *_blocks(plain)])


def _section(name: str, told: str, body: str) -> list[str]:
    """Return a section; ``told`` is what stands behind its name."""
    if name == "Example":
        return [f"**{name}**", _code(body)]
    if told or name not in _LISTS:
        text = " ".join(f"{told} {body}".split()) if told else body
        first, *rest = _blocks(text.splitlines())
        return [f"**{name}:** {first}", *rest]
    items = re.split(r"\n(?! )", body)
    return [f"**{name}**", "\n".join(_item(" ".join(item.split())) for item in items)]


def _item(text: str) -> str:
    named = _ITEM.match(text)
    return f"- {_prose(text)}" if named is None else f"- `{named[1]}`: {_prose(named[2])}"


def _blocks(lines: Sequence[str]) -> list[str]:
    """Return paragraphs and pieces of code."""
    found = []
    for block in re.split(r"\n\s*\n", "\n".join(lines).strip("\n")):
        if block.strip():
            found.append(_code(textwrap.dedent(block), "") if block.startswith("    ") else _prose(block))
    return found


def _code(text: str, language: str = "python") -> str:
    return f"```{language}\n{text}\n```"


def _prose(text: str) -> str:
    """Return text in which nothing but code has a meaning for markdown."""
    pieces = re.split(r"(``?[^`]+``?)", text)
    return "".join(
        f"`{piece.strip('`')}`" if piece.startswith("`") else re.sub(r"([*<])", r"\\\1", piece) for piece in pieces
    )


def main(arguments: Sequence[str], file: Path = PAGE) -> int:
    """Write the page, or with ``--check`` say whether it is up to date; return the exit code."""
    made = page()
    if list(arguments) != ["--check"]:
        file.write_text(made, encoding="utf-8")
        return 0
    if file.is_file() and file.read_text(encoding="utf-8") == made:
        return 0
    print(f"{file.name} differs from the docstrings: run python docs/make_api.py", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
