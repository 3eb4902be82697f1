"""``torchrbd completion``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal

from cyclopts import App

from torchrbd.cli.parameters import examples, file
from torchrbd.estimators import COMPARABLE

AFTER = examples(
    "torchrbd completion bash > ~/.torchrbd.bash    # source it in ~/.bashrc",
    "torchrbd completion zsh > ~/.zfunc/_torchrbd    # a folder of $fpath",
    "torchrbd completion fish > ~/.config/fish/completions/torchrbd.fish",
)


def of(app: Callable[[Mapping[str, Sequence[str]]], App]) -> Callable[[Any], None]:
    """Return the command that completes what an application understands, which is made with values to offer."""

    def completion(shell: Annotated[Literal["bash", "zsh", "fish"], file("SHELL", "bash, zsh or fish")], /) -> None:
        """Print a script with which a shell completes commands, options and their values."""
        from torchrbd.effects import known_effects

        effects = tuple(known_effects())
        offered = app({"effects": effects, "exclude": effects, "estimators": COMPARABLE})
        print(offered.generate_completion(prog_name="torchrbd", shell=shell))

    return completion
