"""Processes of one run that ``torchrun`` has started, on one machine or on several: who does what, and sums over all.

    torchrun --nproc-per-node 2 -m torchrbd stats ROBOT.urdf FILES... -o DIR

Messages go through torch.distributed's gloo. Without ``torchrun`` there is one process, and nothing is imported.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, TypeVar

from torchrbd.errors import TorchRBDError

Item = TypeVar("Item")

# A process that has heard nothing of another for so long takes it for dead [s]; that of a large file may be slow.
_PATIENCE_S = 24 * 3600


@dataclass(frozen=True)
class Ranks:
    """The place of this process among all.

    Attributes:
        rank: number of this process, 0 to world - 1.
        world: how many there are.
    """

    rank: int = 0
    world: int = 1

    @property
    def first(self) -> bool:
        """Whether this process is the one that speaks and writes what all have made."""
        return self.rank == 0

    def own(self, items: Sequence[Item]) -> list[Item]:
        """Return the part of a list that this process works on."""
        return list(items[self.rank :: self.world])

    def wait(self) -> None:
        """Wait until all have come here.

        Raises:
            TorchRBDError: another process has ended.
        """
        self.gathered(None)

    def gathered(self, value: Any) -> list[Any]:
        """Return what each process has given, in the order of their ranks; small values only.

        Raises:
            TorchRBDError: another process has ended.
        """
        if self.world == 1:
            return [value]
        from torch import distributed

        found: list[Any] = [None] * self.world
        with _all_alive():
            distributed.all_gather_object(found, value)
        return found

    def summed(self, values: Any) -> Any:
        """Return the sum over all processes of a tensor, which is overwritten.

        Raises:
            TorchRBDError: another process has ended.
        """
        if self.world > 1:
            from torch import distributed

            with _all_alive():
                distributed.all_reduce(values)
        return values


@contextmanager
def ranks() -> Iterator[Ranks]:
    """Join the processes of this run, and leave them."""
    world = int(os.environ.get("WORLD_SIZE", "1")) if "TORCHELASTIC_RUN_ID" in os.environ else 1
    if world == 1:
        yield Ranks()
        return
    from torch import distributed

    with _all_alive():
        distributed.init_process_group("gloo", timeout=timedelta(seconds=_PATIENCE_S))
    try:
        yield Ranks(distributed.get_rank(), world)
    finally:
        distributed.destroy_process_group()


@contextmanager
def _all_alive() -> Iterator[None]:
    try:
        yield
    except RuntimeError:
        raise TorchRBDError(
            "another process of this run has ended or cannot be reached; files that are written stay, run the same "
            "command again to go on from them"
        ) from None
