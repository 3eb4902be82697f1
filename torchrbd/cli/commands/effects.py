"""``torchrbd effects``."""

from __future__ import annotations

from torchrbd.cli.parameters import examples

AFTER = examples("torchrbd effects")


def effects() -> None:
    """List the effects that can be missing: their ids, what they are, and their torque."""
    from torchrbd.cli.tables import print_effects
    from torchrbd.effects import known_effects

    print_effects(known_effects().values())
