"""The parameters of commands: those made from ``torchrbd.options``, and those that several commands share."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, cast, get_args, get_origin, get_type_hints

from cyclopts import Group, Parameter

from torchrbd.options import Options, Spelling, plain_words, spelling, spelt

Command = TypeVar("Command", bound=Callable[..., Any])

_GROUPS = {name: Group(name, sort_key=k) for k, name in enumerate(("Data", "Model", "Motion", "Limits"), start=3)}
_RECORDING = (
    "CSV, Parquet, NPZ or MATLAB file with columns t [s], q_<joint> [rad, m], tau_<joint> [N m, N], optionally "
    "qd_<joint>, q_ref_<joint>, q_link_<joint> (encoder behind the gear), temperature_<joint> [degC]; or a ROS bag, an "
    "MCAP file or a LeRobot data set"
)
_CONFIG = (
    "file with any of these options, e.g. 'cutoff: 5'; options on the command line have "
    "priority; relative paths in it start from its folder. 'torchrbd schema config' prints its keys"
)


def value(metavar: str, words: str, *, short: str = "", name: str = "", group: str = "", default: Any = None) -> Any:
    """Return how an option with one value is spelled and shown.

    Args:
        metavar: what it is followed by.
        words: what ``--help`` says.
        short: one letter for it.
        name: where it is not the parameter's.
        group: heading in ``--help``.
        default: shown behind the words.
    """
    shown = f"{words} (default: {default})" if default is not None else words
    # An alias and a name cannot be given alike: a name replaces the parameter's own, an alias stands next to it.
    more: dict[str, Any] = {"name": f"--{name}"} if name else {}
    if short:
        more["alias"] = f"-{short}"
    if group:
        more["group"] = _GROUPS[group]
    return Parameter(help=shown, negative=(), **_metavar(metavar), show_default=False, show_choices=False, **more)


def values(metavar: str, words: str, *, name: str = "", group: str = "") -> Any:
    """Return the same of an option with several values."""
    more: dict[str, Any] = {"name": f"--{name}"} if name else {}
    if group:
        more["group"] = _GROUPS[group]
    return Parameter(
        help=words, negative=(), **_metavar(metavar), show_default=False, consume_multiple=(1, None), **more
    )


def _metavar(word: str) -> dict[str, Any]:
    """Return what an option is followed by; cyclopts 4, the last for Python 3.10, cannot show it."""
    return {"metavar": word} if "metavar" in inspect.signature(Parameter).parameters else {}


def flag(words: str, *, short: str = "") -> Any:
    """Return how an option without a value is shown."""
    more: dict[str, Any] = {"alias": f"-{short}"} if short else {}
    return Parameter(help=words, negative=(), show_default=False, **more)


def file(name: str, words: str) -> Any:
    """Return how a positional parameter is shown."""
    return Parameter(name=name, help=words, negative=(), show_default=False)


Robot: TypeAlias = Annotated[Path, file("ROBOT", "robot model: a URDF or MJCF file")]
Recordings: TypeAlias = Annotated[list[Path], file("RECORDING", _RECORDING)]
Recording: TypeAlias = Annotated[Path, file("RECORDING", _RECORDING)]
Statistics: TypeAlias = Annotated[
    list[Path], file("RECORDING", f"{_RECORDING}; .stats files of 'torchrbd stats' are understood, too")
]
Folder: TypeAlias = Annotated[Path, value("DIR", "folder for the results", short="o")]
FolderIfAny: TypeAlias = Annotated[Path | None, value("DIR", "folder for the results", short="o")]
Quiet: TypeAlias = Annotated[bool, flag("print no progress on stderr", short="q")]
Config: TypeAlias = Annotated[Path | None, value("YAML", _CONFIG)]
MappingFile: TypeAlias = Annotated[Path | None, value("YAML", "column names and units of the recordings")]
Cutoff: TypeAlias = Annotated[
    float | None,
    value("HZ", "band limit of their motion", name="cutoff", default="chosen from the data"),
]
Gravity: TypeAlias = Annotated[
    tuple[float, float, float] | None,
    value("X Y Z", "acceleration in the base's axes [m/s^2]", default="0 0 -9.81"),
]


def with_options(names: Iterable[str] = Options.names()) -> Callable[[Command], Command]:
    """Give a command the options of these names; it gets those that the user gave as keyword arguments ``**options``.

    A decorator. None means that an option was not given.
    """
    wanted, keyword = set(names), inspect.Parameter.KEYWORD_ONLY
    added = [
        inspect.Parameter(f.name, keyword, default=None, annotation=_annotation(f.name, spelling(f)))
        for f in fields(Options)
        if f.name in wanted
    ]

    def decorate(command: Command) -> Command:
        own = inspect.signature(command)
        kept = [p for p in own.parameters.values() if p.kind is not p.VAR_KEYWORD]
        command.__signature__ = own.replace(parameters=[*kept, *added])  # type: ignore[attr-defined]
        command.__annotations__ = {
            **{name: kind for name, kind in command.__annotations__.items() if name in {p.name for p in kept}},
            **{p.name: p.annotation for p in added},
        }
        return command

    return decorate


def _annotation(name: str, how: Spelling) -> Any:
    """Return type and looks of an option."""
    kind: Any = Literal[how.choices] if how.choices else how.kind
    if how.many:
        shown = values(how.metavar, plain_words(name), name=spelt(name), group=how.group)
        return Annotated[list[kind] | None, shown]
    if how.count > 1:
        kind = tuple[(kind,) * how.count]
    return Annotated[kind | None, value(how.metavar, plain_words(name), name=spelt(name), group=how.group)]


def completing(command: Command, offered: Mapping[str, Sequence[str]]) -> Command:
    """Return a command for whose options, by name, a shell offers these values; others are understood as well."""
    own, kinds = inspect.signature(command), get_type_hints(command, include_extras=True)
    if not own.parameters.keys() & offered.keys():
        return command

    @wraps(command)
    def same(*arguments: Any, **options: Any) -> Any:
        return command(*arguments, **options)

    for name in own.parameters.keys() & offered.keys():
        kinds[name] = Annotated[list[Literal[tuple(offered[name])] | str] | None, kinds[name].__metadata__[0]]
    named = [p.replace(annotation=kinds[p.name]) for p in own.parameters.values()]
    same.__signature__ = own.replace(parameters=named)  # type: ignore[attr-defined]
    same.__annotations__ = kinds
    return cast(Command, same)


def examples(*lines: str) -> str:
    """Return lines as the end of a command's help."""
    return "\n".join(("Examples:", *(f"  {line}" for line in lines)))


def usage(name: str, command: Callable[..., Any]) -> str:
    """Return the first line of a command's help: files, options that must be there, the rest."""
    parts = ["Usage: torchrbd", name]
    options = False
    for one in get_type_hints(command, include_extras=True).items():
        parameter, (kind, how, *_) = inspect.signature(command).parameters.get(one[0]), get_args(one[1]) or (None, None)
        if parameter is None or how is None:
            continue
        if parameter.kind is parameter.POSITIONAL_ONLY:
            word = how.name[0] + ("..." if get_origin(kind) is list else "")
            parts.append(word if parameter.default is parameter.empty else f"[{word}]")
        elif parameter.default is parameter.empty:
            parts.append(f"{(how.alias or (f'--{one[0]}',))[0]} {getattr(how, 'metavar', 'VALUE')}")
        else:
            options = True
    return " ".join((*parts, *(["[OPTIONS]"] if options else [])))
