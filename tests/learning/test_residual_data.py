"""Recordings become samples through one filter, and no sample of training has to do with one of the test."""

from __future__ import annotations

from itertools import combinations

import pandas as pd
import pytest
import torch
from learning.residual_problems import NAMES, ROBOT, URDF, physics, recording
from torch.utils.data import DataLoader

import torchrbd
from torchrbd import residual_dataset
from torchrbd.errors import InputError, OptionError, RecordingError
from torchrbd.inference.preparation import read
from torchrbd.inference.settings import Settings
from torchrbd.learning import physics_columns
from torchrbd.learning.splits import SPLITS, split_rows
from torchrbd.recordings import tiles

N, CUTOFF_HZ = ROBOT.n_dof, 4.0


def test_torques_and_columns_are_filtered_alike() -> None:
    """Measured and predicted torque are each low-passed at the full rate; so is every column."""
    model = physics()
    data = residual_dataset(model, recording(), cutoff_hz=CUTOFF_HZ, dtype=torch.float64)
    reading, _ = read(ROBOT, [recording()], Settings(cutoff_hz=CUTOFF_HZ))
    (states,) = tiles(recording(), reading.surveys[0], reading.filtering)
    full = (states.q.T, states.qd.T, states.qdd.T)
    with torch.no_grad():
        said = model(*full)
    torch.testing.assert_close(data.physics_torque, states.decimate(said.T).T)
    torch.testing.assert_close(data.measured, states.decimate(states.tau).T)
    torch.testing.assert_close(data.residual, states.decimate(states.tau - said.T).T)
    torch.testing.assert_close(data.features, torch.cat([states.decimate(x.T) for x in full]).T)
    torch.testing.assert_close(data.t, states.t_out)
    columns = physics_columns(model, *full)
    some = states.decimate(columns.permute(1, 2, 0)).permute(2, 0, 1)[data.sample]
    torch.testing.assert_close(data.columns, some)
    torch.testing.assert_close(data.weight, data.residual.square().mean(0).reciprocal().expand_as(data.weight))


def test_tiles_join_and_history_goes_back_in_time() -> None:
    long = recording(150.0, reference=True)
    data = residual_dataset(physics(), long, cutoff_hz=CUTOFF_HZ, history=3, dtype=torch.float64)
    plain = residual_dataset(physics(), long, cutoff_hz=CUTOFF_HZ, dtype=torch.float64)
    assert len(data) == len(plain) - 2
    assert data.features.shape[1] == (3 + 2 * 3) * N
    torch.testing.assert_close(data.features[:, : 3 * N], plain.features[2:])
    velocity, past = plain.features[:, N : 2 * N], data.features[:, 3 * N :].unflatten(1, (3, 2, N))
    for k in range(3):
        torch.testing.assert_close(past[:, k, 1], velocity[2 - k : len(velocity) - k])
        torch.testing.assert_close(past[:, k, 0], 0.01 * past[:, k, 1], rtol=1e-2, atol=1e-4)
    assert (data.t.diff() - data.dt).abs().amax() < 1e-9
    torch.testing.assert_close(data.columns[:, :, 0], plain.columns[-len(data.columns) :, :, 0])


def test_splits_are_apart_by_what_the_filters_reach() -> None:
    options = {"cutoff_hz": CUTOFF_HZ, "fractions": (0.6, 0.2, 0.2)}
    recordings = [recording(), recording(50.0, 1, "other")]
    parts = {split: residual_dataset(physics(), recordings, split=split, **options) for split in SPLITS}
    reading, _ = read(ROBOT, recordings, Settings(cutoff_hz=CUTOFF_HZ))
    reach = reading.filtering.reach(0.01) * 0.01
    for one, other in combinations(parts.values(), 2):
        for k in range(2):
            a, b = one.t[one.recording == k], other.t[other.recording == k]
            if len(a) and len(b):
                assert (a.unsqueeze(1) - b).abs().amin() >= 2 * reach - 1e-9
    counts = torch.tensor([len(part) for part in parts.values()]).double()
    assert (counts / counts.sum() - torch.tensor([0.6, 0.2, 0.2])).abs().amax() < 0.15
    for part in parts.values():
        torch.testing.assert_close(part.noise_std, parts["train"].noise_std)
        torch.testing.assert_close(part.columns.shape[1:], parts["train"].columns.shape[1:])
        assert part.sample.amax() < len(part)
    metric, train = parts["train"].metric, parts["train"]
    torch.testing.assert_close(metric.features, train.features[train.sample])


def test_no_part_is_left_out_but_gaps() -> None:
    t = torch.arange(0.0, 100.0, 0.1, dtype=torch.float64)
    label = split_rows(t, torch.zeros(1000, dtype=torch.long), (0.5, 0.25, 0.25), 0.5)
    changes = t[1:][label.diff() != 0]
    assert (label == -1).double().mean() < 0.25
    assert len(changes) > 6
    assert set(label.tolist()) == {-1, 0, 1, 2}
    whole = split_rows(t, torch.zeros(1000, dtype=torch.long), (1.0, 0.0, 0.0), 0.5)
    assert (whole == 0).all()


def test_samples_go_through_a_loader() -> None:
    data = residual_dataset(physics(), recording(), split="train")
    features, residual, weight = next(iter(DataLoader(data, batch_size=16, shuffle=True)))
    assert features.shape == (16, 3 * N)
    assert residual.shape == weight.shape == (16, N)
    assert features.dtype == residual.dtype == torch.float32
    torch.testing.assert_close(data[[3, 5]][0], torch.stack((data[3][0], data[5][0])))
    some = data.select(data.t < 10.0)
    assert 0 < len(some) < len(data)
    torch.testing.assert_close(some.metric.features, some.features[some.sample])


def test_tables_dicts_and_files_are_one(tmp_path) -> None:
    chunk = next(recording().chunks(10**6))
    assert chunk.tau is not None
    arrays = {"t": chunk.t, "q": chunk.q, "tau": chunk.tau}
    columns = {"t": chunk.t}
    for j, name in enumerate(NAMES):
        columns |= {f"q_{name}": chunk.q[:, j], f"tau_{name}": chunk.tau[:, j]}
    table = pd.DataFrame(columns)
    table.to_parquet(tmp_path / "one.parquet")
    expected = residual_dataset(physics(), recording()).residual
    for source in (arrays, table, tmp_path / "one.parquet", str(tmp_path / "one.parquet")):
        torch.testing.assert_close(residual_dataset(physics(), source).residual, expected)


def test_an_identification_gives_its_model_band_and_noise() -> None:
    found = torchrbd.identify(URDF, recording(), cutoff_hz=CUTOFF_HZ, estimator="physical")
    data = residual_dataset(found, recording())
    assert data.cutoff_hz == CUTOFF_HZ
    noise = torch.tensor([found.noise[joint].torque for joint in NAMES])
    torch.testing.assert_close(data.noise_std, noise, check_dtype=False)
    torch.testing.assert_close(data.weight[0], (noise**-2.0), check_dtype=False)
    assert data.residual.square().mean() < residual_dataset(physics(), recording()).residual.square().mean()
    with torch.no_grad():
        said = found.model(*data.features.double().unflatten(1, (3, N)).unbind(1))
    assert (said - data.physics_torque).square().mean() < 1e-3 * data.physics_torque.square().mean()


def test_joints_without_torque_weigh_nothing() -> None:
    chunk = next(recording().chunks(10**6))
    assert chunk.tau is not None
    columns = {"t": chunk.t, f"tau_{NAMES[0]}": chunk.tau[:, 0]}
    data = residual_dataset(physics(), columns | {f"q_{name}": q for name, q in zip(NAMES, chunk.q.T, strict=True)})
    assert (data.weight[:, 1] == 0).all()
    assert (data.residual[:, 1] == 0).all()
    assert (data.weight[:, 0] > 0).all()
    assert torch.isfinite(data.metric.basis).all()


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"split": "dev"}, OptionError, "split is 'dev'; expected one of train, validation, test"),
        ({"fractions": (0.5, 0.5)}, OptionError, "expected three of 0 or more that add to 1"),
        ({"fractions": (0.0, 0.5, 0.5)}, OptionError, "of which some is to train with"),
        ({"history": -1}, OptionError, "history is -1"),
        ({"history": 2}, RecordingError, "simulated: history needs set-points, columns q_ref_<joint>"),
        ({"split": "test", "time": (0.0, 3.0)}, RecordingError, "too little to split"),
    ],
)
def test_bad_options_are_refused(options: dict, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        residual_dataset(physics(), recording(), **options)


def test_what_has_no_model_is_refused() -> None:
    with pytest.raises(InputError, match="expected a Diagnosis, an Identification"):
        residual_dataset(3, recording())
