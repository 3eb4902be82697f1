"""The files that a result leaves in its folder."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from torchrbd._runtime.outputs import OutputFolder, write_whole
from torchrbd.diagnosis import Diagnosis
from torchrbd.export import save_model, to_urdf, write_diagnosis, write_parameters
from torchrbd.export.json_files import write_comparison
from torchrbd.inference import EstimatorComparison, Identification
from torchrbd.learning import BayesianDynamics
from torchrbd.report.page import write_report
from torchrbd.report.text.verdict import suspicion_comments

REPORT = "report.html"
IDENTIFIED = ("parameters.json", "identified.urdf", "model.safetensors")
"""Files that an identification writes, besides the report."""


def write_results(result: Identification | Diagnosis | EstimatorComparison, folder: str | Path) -> None:
    """Write the files that the command line writes with ``-o``: JSON, URDF, model and report.

    ``Diagnosis.load(folder)`` and ``Identification.load(folder)`` read them again.

    Args:
        result: what ``diagnose``, ``identify`` or ``compare_estimators`` returned.
        folder: made if it does not exist. Files of an earlier result are replaced.

    Raises:
        OptionError: the folder cannot be written, or another process writes into it.
    """
    with OutputFolder(Path(folder)) as output:
        output.fill(partial(write_files, result))


def write_files(result: Identification | Diagnosis | EstimatorComparison, folder: Path) -> tuple[str, ...]:
    """Write every result file into a folder that exists; return the names of those that other tools read."""
    if isinstance(result, EstimatorComparison):
        write_comparison(result, folder / "estimators.json")
        return ("estimators.json",)
    write_identified(result, folder)
    names = IDENTIFIED
    if isinstance(result, Diagnosis):
        write_diagnosis(result, folder / "diagnosis.json")
        names = (*names, "diagnosis.json")
    write_report(result, folder / REPORT)
    return names


def write_identified(result: Identification | Diagnosis, folder: Path) -> None:
    """Write what other tools read of an identification into a folder."""
    identification = result.identification if isinstance(result, Diagnosis) else result
    parameters, urdf, model = (folder / name for name in IDENTIFIED)
    write_parameters(identification, parameters)
    write_whole(urdf, to_urdf(identification.model, suspicion_comments(identification)))
    if identification.posterior is None:
        save_model(identification.model, model)
    else:
        BayesianDynamics.from_diagnosis(result).save(model)
