"""Bursts of fast motion, where dry friction turns, are no spring in the transmission: an arm simulated by MuJoCo."""

import importlib.util
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from torchrbd.dataset.band import band_hz
from torchrbd.diagnosis.hypotheses import hypothesis_of, rows_with_load
from torchrbd.effects import Site, effect
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.preparation import read
from torchrbd.likelihood.clocks import in_band
from torchrbd.likelihood.likelihood import Likelihood

ROOT = Path(__file__).resolve().parents[2]
# Evidence below this is chance, nats.
FEW = 3.0


@cache
def demo_case() -> ModuleType:
    spec = importlib.util.spec_from_file_location("demo_case", ROOT / "examples" / "demo_case.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def learnt(folder: Path, monkeypatch: pytest.MonkeyPatch, step: float) -> Likelihood:
    """Return what is learnt of 30 s of the demo's arm with dry friction at joint3, simulated at steps of so many s."""
    case = demo_case()
    changed = {"STEP": step, "LOG_EVERY": round(0.004 / step), "DURATIONS": {"fit": 30.0}}
    for name, value in changed.items():
        monkeypatch.setattr(case, name, value)
    case.record(folder, seed=3, effect="coulomb_friction", joint="joint3", value=2.4)
    urdf = ROOT / "torchrbd" / "demo" / "arm.urdf"
    robot, sources, settings = read_arguments(urdf, [folder / "fit.parquet"], {}, "rank_hypotheses")
    reading, _ = read(robot, sources, settings, lambda *_: None)

    def kept_back(_: str, t: torch.Tensor) -> torch.Tensor:
        return torch.zeros(len(t), dtype=torch.bool)

    return in_band(reading, band_hz(reading.surveys), kept_back, frozenset()).fit


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.0005, 0.001])
def test_dry_friction_is_not_taken_for_an_elastic_joint(tmp_path, monkeypatch, step) -> None:
    pytest.importorskip("mujoco")
    fit = learnt(tmp_path, monkeypatch, step)
    rows, spring = rows_with_load(fit), effect("joint_elasticity")
    np.testing.assert_allclose(fit.friction[2, 1:], 2.4, rtol=0.02)
    # Soft and stiff, slow and fast ones; the last one had more than 100 nats.
    shapes = [(1.2, 0.0), (6.0, 0.0), (48.0, 0.0), (66.0, 1.16e-5)]
    for joint in range(3):
        for hz, compliance in shapes:
            shape = {"bandwidth": hz, "compliance": compliance, "link_friction": 0.0}
            found = hypothesis_of(fit, rows, rows.columns.candidate(spring, Site(joint), shape))
            assert found is not None
            assert found.log_evidence < FEW, (joint, hz)
