"""Results come back from their files: what these hold is as it was, what they lack is said."""

from __future__ import annotations

import copy
import json
import pickle
import shutil
import sys
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import torch
from inference.problems import urdf_of
from shortened import without_joint_figures
from simulated import Motion, joint_names, record

import torchrbd
from torchrbd.export import write_diagnosis, write_parameters
from torchrbd.export.schemas import schema
from torchrbd.report.files import write_files

URDF = urdf_of(2, 2)


@pytest.fixture(scope="module")
def found() -> torchrbd.Diagnosis:
    def friction(motion: Motion) -> np.ndarray:
        return np.sign(motion.qd) * [0.0, 0.7]

    return torchrbd.diagnose(URDF, record(URDF, 3, extra=friction, duration_s=20.0), seed=1)


@pytest.fixture(scope="module")
def folder(found: torchrbd.Diagnosis, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("out")
    with without_joint_figures():
        write_files(found, made)
    return made


def test_what_the_files_hold_is_as_it_was(folder: Path, tmp_path: Path) -> None:
    """All of it: written once more, the files are the same."""
    again = torchrbd.Diagnosis.load(folder)
    write_diagnosis(again, tmp_path / "diagnosis.json")
    write_parameters(again.identification, tmp_path / "parameters.json")
    for name in ("diagnosis.json", "parameters.json"):
        assert (tmp_path / name).read_text() == (folder / name).read_text()


def test_a_folder_written_from_python_is_read_again(found: torchrbd.Diagnosis, tmp_path: Path) -> None:
    torchrbd.write_results(found, str(tmp_path / "new" / "out"))
    assert {path.name for path in (tmp_path / "new" / "out").iterdir()} == {
        "diagnosis.json", "identified.urdf", "model.safetensors", "parameters.json", "report.html"
    }  # fmt: skip
    again = torchrbd.Diagnosis.load(tmp_path / "new" / "out")
    assert again.verdict == found.verdict
    assert [f.effect for f in again.findings] == [f.effect for f in found.findings]


def test_the_schema_is_that_of_the_file(folder: Path) -> None:
    content, made = json.loads((folder / "diagnosis.json").read_text()), schema("diagnosis")
    jsonschema.validate(content, made)
    assert made["properties"].keys() >= content.keys() - {"conditions", "finished"}
    assert set(made["required"]) <= content.keys()
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(content | {"findings": [{"effect": 3}]}, made)


def test_results_are_objects_again(found: torchrbd.Diagnosis, folder: Path) -> None:
    again = torchrbd.Diagnosis.load(str(folder))
    assert found.findings
    assert again.findings == found.findings
    assert again.findings[0].where == found.findings[0].where
    assert repr(again) == repr(found)
    one, other = again.identification, found.identification
    assert one.parameters == other.parameters
    assert one.noise == other.noise
    assert one.robot.joint_names == other.robot.joint_names
    np.testing.assert_array_equal(one.base_combination, other.base_combination)
    q, qd, qdd = torch.rand(3, 5, 2, dtype=torch.float64)
    torch.testing.assert_close(one.model(q, qd, qdd), other.model(q, qd, qdd))
    assert torchrbd.Identification.load(folder).verdict == other.verdict
    # Not in all digits: how sums are rounded depends on where arrays lie in memory.
    changes, expected = (torchrbd.compare(one, found).changes for one in (again, found))
    assert [(c.kind, c.effect, c.verdict) for c in changes] == [(c.kind, c.effect, c.verdict) for c in expected]
    assert [c.probability for c in changes] == pytest.approx([c.probability for c in expected])


def test_what_the_files_lack_is_said(folder: Path) -> None:
    again = torchrbd.Diagnosis.load(folder)
    assert again.identification.covariance is None
    assert again.identification.posterior is None
    assert list(again.identification.series.joints) == joint_names(URDF)
    with pytest.raises(torchrbd.InputError, match=r"do not hold torques against time; identify or diagnose the rec"):
        again.identification.series.residual("urdf")
    assert again.ranking is not None
    with pytest.raises(torchrbd.InputError, match=r"do not hold the data that evidence is computed from"):
        again.ranking.evidence_of("coulomb_friction", joint_names(URDF)[:1])
    for one in (copy.deepcopy(again.identification.series), pickle.loads(pickle.dumps(again.identification.series))):
        assert one.joints == again.identification.series.joints


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: (d / "diagnosis.json").unlink(), r"diagnosis.json: cannot be read"),
        (lambda d: (d / "parameters.json").unlink(), r"parameters.json: cannot be read"),
        (lambda d: (d / "model.safetensors").unlink(), r"cannot be read as a model"),
        (lambda d: (d / "diagnosis.json").write_text("{}"), r"is no diagnosis.json as this version .*diagnose the rec"),
        (lambda d: (d / "parameters.json").write_text("[]"), r"expected what 'torchrbd identify' writes"),
        (lambda d: (d / "parameters.json").write_text("{"), r"is not JSON"),
    ],
)
def test_files_that_cannot_be_used_are_named(change, words: str, folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "out")
    change(tmp_path / "out")
    with pytest.raises(torchrbd.InputError, match=words):
        torchrbd.Diagnosis.load(tmp_path / "out")


def test_findings_as_a_table(found: torchrbd.Diagnosis) -> None:
    frame = found.findings_frame()
    (finding,) = found.findings
    assert list(frame.effect) == [finding.effect] * len(finding.parameters)
    assert list(frame.parameter) == list(finding.parameters)
    row = frame.iloc[0]
    quantity = finding.parameters[row.parameter]
    assert (row.value, row["std"], row.unit) == (quantity.value, quantity.std, quantity.unit)
    assert (row.probability, row.joints) == (finding.probability, ", ".join(finding.joints))
    empty = torchrbd.Diagnosis(found.identification, "consistent", "", ())
    assert list(empty.findings_frame().columns) == list(frame.columns)
    assert len(empty.findings_frame()) == 0


def test_a_table_needs_pandas(found: torchrbd.Diagnosis, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(torchrbd.InputError, match=r"pip install pandas"):
        found.findings_frame()
