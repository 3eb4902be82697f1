"""The training of ``torch_loop.py`` by Lightning: the model is a part of a LightningModule, and saved with it.

The trainer takes care of batches, validation and checkpoints; the model in the checkpoint needs nothing of Lightning's.
Needs lightning: ``pip install torchrbd[examples]``.

    python examples/pipelines/lightning_fit.py
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import lightning
import torch
from torch import Tensor
from torch.utils.data import DataLoader, TensorDataset
from torch_loop import DEMO, EFFECTS, dry_friction, errors, loss, optimiser_of, recorded

import torchrbd

EPOCHS, BATCH = 60, 250


class Fit(lightning.LightningModule):
    """Train a model on batches of q, qd, qdd and tau (N, n_dof); ``variance`` (n_dof,) of all torques."""

    variance: Tensor

    def __init__(self, model: torchrbd.RigidBodyDynamics, variance: Tensor) -> None:
        super().__init__()
        self.model = model
        self.register_buffer("variance", variance)

    def training_step(self, batch: Sequence[Tensor], index: int) -> Tensor:
        """Return the loss of a batch."""
        return loss(self.model, batch, self.variance)

    def validation_step(self, batch: Sequence[Tensor], index: int) -> None:
        """Log the held-out error."""
        self.log("nmse", errors(self.model, batch, self.variance).mean())

    def configure_optimizers(self) -> dict[str, object]:
        """Return Adam, whose rates fall to zero over the training."""
        optimiser = optimiser_of(self.model)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, EPOCHS)
        return {"optimizer": optimiser, "lr_scheduler": schedule}


def main() -> float:
    """Train, and return the held-out error as a part of the URDF's."""
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    lightning.seed_everything(0, verbose=False)
    model = torchrbd.RigidBodyDynamics.from_urdf(DEMO / "arm.urdf", effects=EFFECTS)
    training, held_out = (TensorDataset(*recorded(model.robot, name)) for name in ("fit", "holdout"))
    fit = Fit(model, training.tensors[3].var(0))
    trainer = lightning.Trainer(
        accelerator="cpu",
        precision="64-true",
        max_epochs=EPOCHS,
        check_val_every_n_epoch=EPOCHS,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    test = DataLoader(held_out, batch_size=len(held_out))
    (before,) = trainer.validate(fit, test, verbose=False)
    trainer.fit(fit, DataLoader(training, BATCH, shuffle=True), test)
    after = trainer.callback_metrics["nmse"].item()
    print(f"held-out nmse: {before['nmse']:.4f} with the URDF, {after:.5f} after {EPOCHS} epochs")
    print(f"Coulomb friction at joint3: {dry_friction(model, 'joint3'):.2f} N m, 2.4 in truth")
    return after / before["nmse"]


if __name__ == "__main__":
    main()
