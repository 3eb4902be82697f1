"""All commands as one application; building it imports nothing that computes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from cyclopts import App, Group

from torchrbd import __version__
from torchrbd.cli.commands import (
    compare,
    compare_estimators,
    completion,
    demo,
    diagnose,
    effects,
    excite,
    export,
    fleet,
    identify,
    inspect,
    merge,
    schema,
    simulate,
    stats,
)
from torchrbd.cli.parameters import completing, usage

_COMMANDS = {
    "Identify and diagnose": (
        diagnose,
        identify,
        compare,
        compare_estimators,
        demo,
    ),
    "Record": (inspect, excite),
    "Use": (export, simulate),
    "Much data, many robots": (stats, merge, fleet),
    "Reference": (effects, schema, completion),
}


def app(offered: Mapping[str, Sequence[str]] = MappingProxyType({})) -> App:
    """Return the application.

    Args:
        offered: values of options, by name, that a shell is to complete, see ``completing``.
    """
    about = Group("Options", sort_key=2)
    found = App(
        "torchrbd",
        help="Find, name and model the physics that a robot's URDF leaves out.",
        help_epilogue="'torchrbd COMMAND --help' has the options of a command, with examples.",
        help_format="plaintext",
        version=f"torchrbd {__version__}\n",
        group_parameters=about,
        group_arguments=Group("Arguments", sort_key=1),
        # ``main`` answers Ctrl-C, with a word and exit code 130.
        suppress_keyboard_interrupt=False,
    )
    for k, (title, modules) in enumerate(_COMMANDS.items()):
        group = Group(title, sort_key=k)
        for j, module in enumerate(modules):
            # The one that completes the others has to know them.
            name = module.__name__.rpartition(".")[2]
            command = module.of(app) if module is completion else completing(getattr(module, name), offered)
            name = name.replace("_", "-")
            found.command(
                command,
                name=name,
                group=group,
                sort_key=j,
                help_epilogue=f"{module.AFTER}\n",
                usage=usage(name, command),
            )
    found["--help"].group = found["--version"].group = (Group("Options", sort_key=len(_COMMANDS)),)
    return found
