"""Read what two diagnoses say, whether they are at hand or in diagnosis.json and parameters.json."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchrbd._runtime.rebuilding import read_json, rebuilt
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.results import DetectionLimit, Finding, Unexplained
from torchrbd.errors import InputError

_FILE, PARAMETERS = "diagnosis.json", "parameters.json"


@dataclass(frozen=True)
class Inertia:
    """What a diagnosis says of the identifiable combinations beta = K pi.

    Attributes:
        columns: (n_params,) names of the inertial parameters pi.
        K: (n_base, n_params).
        pi: (n_params,) the fit.
        beta, covariance: (n_base,) and (n_base, n_base).
        share: (n_base,) share of information from the prior: 0 (the data alone) to 1 (the URDF alone).
        expressions, units: (n_base,).
    """

    columns: tuple[str, ...]
    K: np.ndarray
    pi: np.ndarray
    beta: np.ndarray
    covariance: np.ndarray
    share: np.ndarray
    expressions: tuple[str, ...]
    units: tuple[str, ...]

    def alike(self, other: Inertia) -> bool:
        """Say whether both are the same combinations of the same parameters, to rounding."""
        if self.columns != other.columns or self.K.shape != other.K.shape:
            return False
        return bool(np.allclose(self.K, other.K, rtol=1e-6, atol=1e-9))


@dataclass(frozen=True)
class Side:
    """One of two diagnoses.

    ``bodies`` are the owners of the columns of ``inertia``, which is None where it is not known.
    """

    name: str
    robot: str
    joints: tuple[str, ...]
    recordings: tuple[str, ...]
    cutoff_hz: float
    findings: tuple[Finding, ...]
    unexplained: tuple[Unexplained, ...]
    detection_limits: tuple[DetectionLimit, ...]
    simulated: tuple[str, ...]
    inertia: Inertia | None
    bodies: tuple[str, ...]


def side_of(source: Diagnosis | str | Path, name: str) -> Side:
    """Read a diagnosis.

    Args:
        source: a diagnosis, its folder, or its diagnosis.json.
        name: what to call a diagnosis that has no path.

    Raises:
        InputError: no such file, not a file of torchrbd, or its verdict is "suspect": it says nothing of the robot.
    """
    if isinstance(source, Diagnosis):
        _check_verdict(name, source.verdict, source.statement)
        return _of_diagnosis(source, name)
    return _of_file(Path(source))


def _check_verdict(name: str, verdict: object, statement: object) -> None:
    if verdict == "suspect":
        raise InputError(f"{name}: its input is suspect, so that nothing can be compared. {statement}")


def _of_diagnosis(result: Diagnosis, name: str) -> Side:
    one = result.identification
    own = {p.name: p for p in one.parameters if p.status != "term"}
    columns, inertia = tuple(one.robot.parameter_names), None
    if one.base_covariance is not None:
        inertia = Inertia(
            columns,
            one.base_combination,
            np.array([own[c].value for c in columns]),
            np.array([b.value for b in one.base]),
            one.base_covariance,
            np.array([b.prior_share for b in one.base]),
            tuple(b.expression for b in one.base),
            tuple(b.unit for b in one.base),
        )
    return Side(
        name,
        one.robot.name,
        tuple(one.series.joints),
        one.recordings,
        one.cutoff_hz,
        result.findings,
        result.unexplained,
        result.detection_limits,
        result.simulated,
        inertia,
        tuple(own[c].owner for c in columns),
    )


def _of_file(path: Path) -> Side:
    file = path / _FILE if path.is_dir() else path
    content = read_json(file, "diagnose")
    _check_verdict(str(path), content.get("verdict"), content.get("statement", ""))
    try:
        # Which an identification lacks.
        content["findings"]
        known: dict[str, Any] = {
            key: rebuilt(kind, content.get(key, ()))
            for key, kind in (
                ("findings", tuple[Finding, ...]),
                ("unexplained", tuple[Unexplained, ...]),
                ("detection_limits", tuple[DetectionLimit, ...]),
                ("simulated", tuple[str, ...]),
            )
        }
        known |= {"robot": str(content["robot"]), "cutoff_hz": float(content["cutoff_hz"])}
        known |= {key: tuple(map(str, content[key])) for key in ("joints", "recordings")}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{file}: is no diagnosis.json as 'torchrbd diagnose' writes it ({type(error).__name__}: {error}); "
            "diagnose the recordings again"
        ) from None
    inertia, bodies = read_inertia(file.parent / PARAMETERS)
    return Side(name=str(path), inertia=inertia, bodies=bodies, **known)


def read_inertia(file: Path) -> tuple[Inertia | None, tuple[str, ...]]:
    """Return what parameters.json says, None if it is not there or has no intervals, and the owner of each parameter.

    Raises:
        InputError: it is none of ours.
    """
    if not file.is_file():
        return None, ()
    content = read_json(file, "diagnose")
    try:
        columns = tuple(content["base_combination"]["columns"])
        own = {p["name"]: p for p in content["parameters"]}
        bodies, base = tuple(own[c]["owner"] for c in columns), content["base_parameters"]
        if content["base_covariance"] is None:
            return None, bodies
        inertia = Inertia(
            columns,
            np.array(content["base_combination"]["matrix"], dtype=float).reshape(len(base), len(columns)),
            np.array([own[c]["value"] for c in columns], dtype=float),
            np.array([b["value"] for b in base], dtype=float),
            np.array(content["base_covariance"], dtype=float).reshape(len(base), len(base)),
            np.array([b["prior_share"] for b in base], dtype=float),
            tuple(b["expression"] for b in base),
            tuple(b["unit"] for b in base),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{file}: is no parameters.json as 'torchrbd diagnose' writes it ({type(error).__name__}: {error}); "
            "diagnose the recordings again, or remove it to compare findings alone"
        ) from None
    return inertia, bodies
