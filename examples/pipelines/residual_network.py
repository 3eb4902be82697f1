"""A residual network on the model: physics first, the network for what is left, silent where it has seen nothing.

The bundled arm is identified without friction, so that the network has to find the dry friction of joint3 by itself.
With friction in the model there is nothing left for it.

    python examples/pipelines/residual_network.py
"""

from __future__ import annotations

import torch
from torch_loop import DEMO

import torchrbd


def main() -> float:
    """Return the error with the network as a part of that without, on samples that neither fit nor choice has seen."""
    identified = torchrbd.identify(DEMO / "arm.urdf", DEMO / "fit.parquet", effects=[])
    train, validation, test = (
        torchrbd.residual_dataset(identified, DEMO / "fit.parquet", split=part)
        for part in ("train", "validation", "test")
    )
    torch.manual_seed(0)
    model = torchrbd.ResidualDynamics(identified.model)
    torchrbd.fit_residual(model, train, validation=validation, epochs=300, lr=3e-3, progress=False)
    shares = model.shares(test)
    alone, both = (x[2].item() for x in (shares.alone_inside, shares.left_inside))
    print(f"error at joint3 inside the region of the data: {alone:.3f} N m of physics, {both:.3f} N m with the network")
    print(f"{100 * shares.outside:.0f} % of the samples lie outside, where the model is its physics")
    return both / alone


if __name__ == "__main__":
    main()
