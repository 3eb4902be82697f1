"""``torchrbd completion``."""

from __future__ import annotations

from typing import Annotated, Literal

from torchrbd.cli.parameters import examples, file

AFTER = examples(
    'eval "$(torchrbd completion bash)"    # also a line for ~/.bashrc',
    "torchrbd completion zsh > ~/.zfunc/_torchrbd    # a folder of $fpath",
    "torchrbd completion fish > ~/.config/fish/completions/torchrbd.fish",
)


def completion(shell: Annotated[Literal["bash", "zsh", "fish"], file("SHELL", "bash, zsh or fish")], /) -> None:
    """Print a script with which a shell completes commands and options."""
    from torchrbd.cli.app import app

    print(app().generate_completion(prog_name="torchrbd", shell=shell))
