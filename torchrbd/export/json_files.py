"""parameters.json and diagnosis.json, which other tools read: keys are added, never renamed."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torchrbd.diagnosis import Diagnosis
from torchrbd.inference import Identification

SCHEMA = 1


def write_parameters(result: Identification, path: Path) -> None:
    """Write every parameter with its uncertainty, and what is identified only in combination."""
    _write(
        path,
        {
            **_head(result),
            "parameters": [asdict(p) for p in result.parameters],
            "combinations": list(result.combinations),
            "base_parameters": [asdict(p) for p in result.base],
            "noise_std": {joint: noise.torque for joint, noise in result.noise.items()},
            "noise": {joint: asdict(noise) for joint, noise in result.noise.items()},
            "states": result.states,
            "regime": result.regime,
        },
    )


def write_diagnosis(result: Diagnosis, path: Path) -> None:
    """Write verdict, fits, findings and what is left unexplained."""
    _write(
        path,
        {
            **_head(result.identification),
            "verdict": result.verdict,
            "statement": result.statement,
            "findings": [asdict(f) for f in result.findings],
            "unexplained": [asdict(u) for u in result.unexplained],
        },
    )


def _head(result: Identification) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "robot": result.robot.name,
        "joints": list(result.series.joints),
        "recordings": list(result.recordings),
        "held_out": result.held_out,
        "cutoff_hz": result.cutoff_hz,
        "fit": {name: asdict(fit) for name, fit in result.fits.items()},
        "notes": list(result.notes),
    }


def _write(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(_finite(content), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _finite(value: Any) -> Any:
    """Replace numbers that JSON has no word for by null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    return value
