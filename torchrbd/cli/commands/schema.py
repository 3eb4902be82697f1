"""``torchrbd schema``."""

from __future__ import annotations

from typing import Annotated, Literal

from torchrbd.cli.parameters import examples, file

AFTER = examples(
    "torchrbd schema mapping",
    "torchrbd schema config > options.json    # for an editor that checks YAML",
)


def schema(
    of: Annotated[
        Literal["mapping", "robots", "config", "diagnosis"],
        file("FILE", "mapping (of --mapping), robots (of fleet), config (of --config) or diagnosis (diagnosis.json)"),
    ],
    /,
) -> None:
    """Print the JSON schema of a file: its keys, with what they mean."""
    import json

    from torchrbd.export.schemas import schema as made

    print(json.dumps(made(of), indent=1, ensure_ascii=False))
