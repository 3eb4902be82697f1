"""parameters.json holds what the result holds, in full digits, and is JSON whatever the numbers are."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from inference.problems import urdf_of
from report.fabricated import ranking
from shortened import fit_alone
from simulated import record, with_wrong_inertials

from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.results import (
    Alternative,
    Curve,
    Elpd,
    Finding,
    Law,
    Quantity,
    Ratio,
    Region,
    Unexplained,
    Where,
)
from torchrbd.display import Remark
from torchrbd.export import write_parameters
from torchrbd.export.json_files import write_comparison, write_diagnosis
from torchrbd.inference import EstimatorComparison, Fit, Identification, identify
from torchrbd.inference.comparison import EstimatorRow
from torchrbd.inference.results import NoiseRegime

URDF = urdf_of(4, 4)


@pytest.fixture(scope="module")
def found() -> Identification:
    with fit_alone():
        return identify(with_wrong_inertials(URDF, 1), record(URDF, 4))


def read(path: Path) -> dict:
    def no_constant(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=no_constant)


def test_base_parameters_follow_from_the_file_alone(found: Identification, tmp_path: Path) -> None:
    write_parameters(found, tmp_path / "p.json")
    content = read(tmp_path / "p.json")
    K = np.array(content["base_combination"]["matrix"])
    value = {p["name"]: p["value"] for p in content["parameters"]}
    beta = K @ [value[name] for name in content["base_combination"]["columns"]]
    np.testing.assert_allclose(beta, [b["value"] for b in content["base_parameters"]], rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(K, found.base_combination)
    np.testing.assert_array_equal(content["base_covariance"], found.base_covariance)


def test_a_row_of_a_matrix_is_a_line_and_text_stays_as_it_is(found: Identification, tmp_path: Path) -> None:
    texts = ["[1,  2]", "a [\n 1\n]"]
    odd = replace(found, facts=(Remark("unused columns", {"columns": texts}),))
    write_parameters(odd, tmp_path / "p.json")
    content = read(tmp_path / "p.json")
    assert content["facts"] == [{"kind": "unused columns", "values": {"columns": texts}, "recording": ""}]
    assert content["notes"] == [f"columns not used: {', '.join(texts)}"]
    lines = (tmp_path / "p.json").read_text().splitlines()
    rows = [line for line in lines if line.strip().startswith("[ ") and line.count(",") > 3]
    assert len(rows) == 2 * len(found.base)


def test_what_is_not_known_is_null(found: Identification, tmp_path: Path) -> None:
    unknown = [replace(p, std=np.nan, prior_share=np.nan) for p in found.parameters]
    write_parameters(replace(found, parameters=tuple(unknown), base_covariance=None), tmp_path / "p.json")
    content = read(tmp_path / "p.json")
    assert all(p["std"] is None and p["prior_share"] is None for p in content["parameters"])
    assert content["base_covariance"] is None


def test_a_ranking_keeps_its_numbers_and_its_gaps(found: Identification, tmp_path: Path) -> None:
    ranked = ranking(("a", "b"))
    load, coupling, *_ = ranked.first
    odd = replace(load, log_evidence=-np.inf, window=("x.csv", -np.inf, 3.0))
    ranked = replace(ranked, adopted=(load,), last=(odd, coupling))
    result = Diagnosis(found, "missing_physics", (), ranking=ranked)
    write_diagnosis(result, tmp_path / "d")
    content = read(tmp_path / "d")["ranking"]
    assert content.keys() == {"band_hz", "considered", "delay_s", "misfit", "ordinary", "first", "adopted", "last"}
    assert content["misfit"]["b"] == {"statistic": 42.0, "dof": 3, "p_value": 4e-9}
    assert (content["band_hz"], content["considered"]) == (15.0, 42)
    assert content["delay_s"]["fit.csv"] == {"value": -0.0012, "std": 0.0001}
    assert [len(content[name]) for name in ("ordinary", "first", "adopted", "last")] == [4, 30, 1, 2]
    mass = {"mass": 0.5, "x": 0.1, "y": None, "z": 0.0, "Ixx": 0.01, "Ixy": 0.0}
    told = {"effect": "payload", "joints": [], "links": ["hand"], "log_evidence": 41.25, "parameters": mass}
    window = {"recording": "fit.csv", "from_s": 2.0, "to_s": 8.0}
    assert content["first"][0] == content["adopted"][0] == {**told, "other": None, "window": window, "shape": {}}
    assert content["last"][0]["log_evidence"] is None
    assert content["last"][0]["window"]["from_s"] is None
    assert content["last"][1]["other"] == "a"
    assert content["ordinary"][1]["shape"] == {"width": 0.01}
    write_diagnosis(replace(result, ranking=None), tmp_path / "d")
    assert read(tmp_path / "d")["ranking"] is None


def test_a_comparison_with_an_error_beyond_all_numbers_is_json(tmp_path: Path) -> None:
    fit = Fit({"a": np.inf}, {"a": np.nan})
    rows = (EstimatorRow("tls", fit, fit, False, 0.1, None),)
    regime = NoiseRegime("physical", "filtered", matters=False, excess=1.0)
    compared = EstimatorComparison("arm", ("a",), ("x",), "y", 5.0, 3, np.inf, regime, False, rows, (), ())
    write_comparison(compared, tmp_path / "e.json")
    content = read(tmp_path / "e.json")
    assert content["schema"] == 1
    assert content["condition"] is None
    assert content["rows"][0]["raw"] == {"nmse": {"a": None}, "rmse": {"a": None}}


def test_diagnosis_keeps_its_keys_and_adds_curves(found: Identification, tmp_path: Path) -> None:
    curve = Curve("q_a", (0.0, 1.0), (1.0, np.inf), (0.1, 0.2))
    one = Finding(
        "joint_coupling", ("a",), (), 0.9, 4.0, {"stiffness": Quantity(1.0, 0.1, "N m/rad")},
        Where(None, ((0.0, 1.0),)),
        (Alternative("payload", (), ("hand",), (), {"mass": 0.5}, 0.2),), {"a": 0.2}, {"a": 0.1}, ("q_b",), curve,
    )  # fmt: skip
    left = Unexplained(("a",), ("q_a",), Where(region=(Region("q_a", 0.0, 1.0),)), 0.4, curve)
    write_diagnosis(Diagnosis(found, "missing_physics", (one, replace(one, curve=None)), (left,)), tmp_path / "d")
    content = read(tmp_path / "d")
    first, second = content["findings"]
    assert first.keys() >= {
        "effect", "joints", "links", "probability", "log_evidence_gain", "parameters", "where",
        "indistinguishable_from", "nmse_before", "nmse_after", "statement",
    }  # fmt: skip
    assert first["parameters"]["stiffness"].keys() >= {"value", "std", "unit"}
    assert first["where"] == {"recordings": None, "time_s": [[0.0, 1.0]], "region": None}
    assert first["indistinguishable_from"] == [
        {
            "effect": "payload", "joints": [], "links": ["hand"], "depends_on": [], "parameters": {"mass": 0.5},
            "probability": 0.2,
        }
    ]  # fmt: skip
    assert (first["depends_on"], second["curve"]) == (["q_b"], None)
    (rest,) = content["unexplained"]
    assert rest.keys() >= {"joints", "depends_on", "where", "share", "statement"}
    assert rest["where"]["region"] == [{"signal": "q_a", "low": 0.0, "high": 1.0}]
    for drawn in (first["curve"], rest["curve"]):
        assert drawn == {"signal": "q_a", "at": [0.0, 1.0], "torque": [1.0, None], "std": [0.1, 0.2]}


def test_a_finding_says_its_family_its_laws_and_what_it_carries(found: Identification, tmp_path: Path) -> None:
    one = Finding(
        "stribeck_friction", ("a",), (), 0.6, 40.0, {}, Where(), (), {"a": 0.4, "b": 0.2}, {"a": 0.1, "b": 0.2},
        family="friction", family_probability=0.98, laws=(Law("stribeck_friction", 0.7), Law("quadratic_drag", 0.3)),
        torque_rms={"a": 1.5}, elpd=Elpd(41.5, 6.0, 12.5, 0.75, 0.2), held_out_ratio=Ratio(0.9, 0.8, 1.0),
    )  # fmt: skip
    small = replace(one, effect="torque_ripple", nmse_before={"a": 0.0}, laws=(), elpd=None)
    write_diagnosis(Diagnosis(found, "missing_physics", (one,), not_confirmed=(small,)), tmp_path / "d")
    content = read(tmp_path / "d")
    (told,), (not_confirmed,) = content["findings"], content["not_confirmed"]
    assert (told["family"], told["family_probability"]) == ("friction", 0.98)
    assert told["laws"] == [
        {"effect": "stribeck_friction", "probability": 0.7},
        {"effect": "quadratic_drag", "probability": 0.3},
    ]
    assert told["torque_rms"] == {"a": 1.5}
    assert told["elpd"] == {"value": 41.5, "se": 6.0, "log_evidence": 12.5, "share": 0.75, "torque_share": 0.2}
    assert not_confirmed["elpd"] is None
    assert (told["held_out_ratio"], content["held_out_ratio"]) == ({"value": 0.9, "low": 0.8, "high": 1.0}, None)
    # The largest of its joints.
    assert told["share"] == pytest.approx(0.75)
    assert not_confirmed["effect"] == "torque_ripple"
    assert (not_confirmed["share"], not_confirmed["laws"]) == (0.0, [])
    assert not_confirmed.keys() == told.keys()
