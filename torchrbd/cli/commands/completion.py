"""``torchrbd completion``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from cyclopts import App

from torchrbd.cli.parameters import examples, file

AFTER = examples(
    'eval "$(torchrbd completion bash)"    # also a line for ~/.bashrc',
    "torchrbd completion zsh > ~/.zfunc/_torchrbd    # a folder of $fpath",
    "torchrbd completion fish > ~/.config/fish/completions/torchrbd.fish",
)


def of(app: App) -> Callable[[Any], None]:
    """Return the command that completes what an application understands."""

    def completion(shell: Annotated[Literal["bash", "zsh", "fish"], file("SHELL", "bash, zsh or fish")], /) -> None:
        """Print a script with which a shell completes commands and options."""
        print(app.generate_completion(prog_name="torchrbd", shell=shell))

    return completion
