"""Replay a model on recordings: the torque error that a report has, from the saved model and the recordings alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from torchrbd._runtime.threads import single_threaded
from torchrbd.dataset.reading import Progress, Reading
from torchrbd.display import brief, few
from torchrbd.errors import OptionError
from torchrbd.inference.preparation import read
from torchrbd.inference.results import TorqueSeries
from torchrbd.inference.series import torque_series
from torchrbd.inference.settings import Settings
from torchrbd.model import RigidBodyDynamics
from torchrbd.options import Names, Payload, given
from torchrbd.recordings import Filtering, Sources, listed_sources

_MODEL = "model"


@dataclass(frozen=True)
class Replay:
    """What a model predicts of recorded torques.

    Attributes:
        nmse: by joint, mean squared error / variance of the measured torque, every row counting alike.
        rmse: by joint, root mean squared error [N m, N].
        reported: by joint, the nmse that was reported when the model was fitted; empty if nothing was.
        cutoff_hz: band limit of the torques [Hz].
        series: the torques; "model" is what is predicted, and ``held_out`` marks the rows that count.
    """

    nmse: dict[str, float]
    rmse: dict[str, float]
    reported: dict[str, float]
    cutoff_hz: float
    series: TorqueSeries

    def __repr__(self) -> str:
        errors = [f"{joint}: {x:.3g}" for joint, x in self.nmse.items()]
        return brief(self, nmse=few(errors), cutoff_hz=self.cutoff_hz, recordings=few(self.series.recordings))


@single_threaded()
def replay(
    model: RigidBodyDynamics | str | Path,
    recordings: Sources,
    *,
    held_out: bool = True,
    time: str | tuple[float, float] | None = None,
    joints: Names | None = None,
    payload: Sequence[Payload | str] | Payload | str = (),
    simulated: Sources = (),
    mapping: str | Path | None = None,
    cutoff_hz: float | None = None,
    progress: Progress = lambda *_: None,
) -> Replay:
    """Predict recorded torques with a model, and say how far off it is.

    With the recordings of a fit this gives the reported nmse. A model knows recordings by their files' names. The
    recipe, which any other code can follow:

    1. ``model = torchrbd.load_model(folder)``.
    2. Read q and tau of a recording on an even clock t. Low-pass and differentiate q (state filter, twice the cut-off).
    3. ``tau_model = model(q, qd, qdd, t, temperature, recording=name)``. The name brings in what belongs to this
       recording, see ``model.conditions``: how late or early its torque is, a known load, effects that act in it alone.
    4. Low-pass tau and tau_model with one filter at ``model.reported.cutoff_hz``, and thin both alike. Where tau had
       passed a filter before, tau_model passes ``model.reported.low_pass.kernel(dt)``, too.
    5. Keep the rows in ``model.conditions[name].held_out_s``. All of them count alike.
    6. ``nmse = mean((tau - tau_model)**2) / var(tau)`` by joint.

    The cut-off is the reported one by default; a payload replaces what the model knows. Where a fit was compared with a
    simulator, its recordings are needed again: the model does not have its torque.

    A recording that the model does not know counts as a whole. Its torque is taken to be as late as that of the fitted
    recordings where these agree (``model.conditions[""].delay_s`` and ``lag_s``), and without a load. The filter that
    it had passed, if any, is estimated.

    Args:
        model: a model, its file, or the folder of results that holds it.
        recordings: as in ``identify``.
        held_out: count only rows that no fit has seen, of recordings that the model knows; all rows otherwise.
        time: use only this part of each recording, FROM:TO [s] from its start, e.g. 2:30. In Python, text or a pair of
            numbers. Default: all.
        joints: joints whose torque counts, by name. Default: all.
        payload: known loads, FILE=kg,x,y,z[@LINK]: mass [kg] and centre of mass [m] in the frame of a link. In Python,
            text or ``torchrbd.inference.Payload``. Default: none; of a chain, the link is the last one.
        simulated: recordings of a simulator with the same commands: one for each recording, then one for each of
            ``holdout``, in their order. The robot is compared with them in place of the URDF. Where the simulator has
            other inertials than the URDF, the difference is reported as inertial parameters. Default: none.
        mapping: YAML file with other column names, units, signs, gear ratios or torque constants. Default: columns t,
            q_<joint>, tau_<joint> in SI units.
        cutoff_hz: band limit of torque and features [Hz]. Default: chosen from the data.
        progress: called with the stage and the part of it that is done (0 to 1).

    Raises:
        InputError: a model, recording or option that cannot be used.
        OptionError: no row counts, or a simulator's recording is missing.

    Example:
        >>> found = torchrbd.replay("out", "test.csv")
        >>> found.nmse, found.reported
        ({'joint1': 0.0016, 'joint2': 0.0121}, {'joint1': 0.0016, 'joint2': 0.0121})
    """
    model = model if isinstance(model, RigidBodyDynamics) else RigidBodyDynamics.load(model)
    if cutoff_hz is None and model.reported is not None:
        cutoff_hz = model.reported.cutoff_hz
    settings = Settings.from_mapping(given(locals()), "replay")
    reading, _ = read(model.robot, listed_sources(recordings), settings, progress)
    if model.reported is not None and all(one.name in model.conditions for one in reading.recordings):
        filtering = Filtering(reading.filtering.cutoff_hz, low_pass=model.reported.low_pass)
        reading = replace(reading, filtering=filtering)
    _check_simulated(model, reading)
    model = _loaded(model, reading)

    def counts(name: str, t: Tensor) -> Tensor:
        known = held_out and name in model.conditions
        return model.conditions[name].held_out(t) if known else torch.ones(t.shape, dtype=torch.bool)

    series = torque_series(reading, {_MODEL: model}, counts, progress)
    if not series.held_out.any():
        raise OptionError(
            f"the model was fitted to all of {', '.join(series.recordings)}: no row is held out; give recordings that "
            "it was not fitted to, or held_out=False to count all rows"
        )
    fit, reported = series.fit(_MODEL), {} if model.reported is None else dict(model.reported.nmse)
    return Replay(fit.nmse, fit.rmse, reported, reading.filtering.cutoff_hz, series)


def _check_simulated(model: RigidBodyDynamics, reading: Reading) -> None:
    """Refuse recordings that were compared with a simulator whose recordings are not given.

    Raises:
        OptionError: one is missing.
    """
    known = {one.recording for one in reading.simulated}
    for recording in reading.recordings:
        simulated = model.condition(recording.name).simulated
        if simulated and recording.name not in known:
            raise OptionError(
                f"the model lacks what the simulation '{simulated}' has beyond the URDF in {recording.name}; give it "
                "with simulated=[...], one for each recording"
            )


def _loaded(model: RigidBodyDynamics, reading: Reading) -> RigidBodyDynamics:
    """Return the model with loads that are given now in place of those that it knows."""
    if not reading.payload:
        return model
    about = {"conditions": model.conditions, "reported": model.reported, "drives": model.drives}
    own = RigidBodyDynamics(model.robot, model.pi, model.terms, model.rest_width, **about)
    for name, load in reading.payload.items():
        own.conditions[name] = replace(model.condition(name), load=load)
    return own
