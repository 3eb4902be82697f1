"""Estimators side by side on one robot."""

from __future__ import annotations

from dataclasses import replace

import pytest
from inference.problems import urdf_of
from simulated import record, with_wrong_inertials

from torchrbd.effects import effect
from torchrbd.errors import OptionError
from torchrbd.estimators import COMPARABLE
from torchrbd.inference import comparison
from torchrbd.inference.comparison import EstimatorComparison, compare_estimators
from torchrbd.inference.estimators import Estimate, estimate
from torchrbd.inference.physical.fitting import judge, term_candidates
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.inference.torque_error import Fit
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

URDF = urdf_of(4, 4)
WRONG = RobotModel.from_urdf(with_wrong_inertials(URDF, 1))
NAMES = ("physical", "wls", "iv", "wls", "smoother")
OPTIONS = {"cutoff_hz": 5.0, "effects": ["viscous_friction"]}


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    return [record(URDF, seed, name=f"day{seed}", duration_s=15.0) for seed in (4, 5)]


@pytest.fixture(scope="module")
def compared(recordings: list[Recording]) -> EstimatorComparison:
    return compare_estimators(WRONG, recordings, estimators=NAMES, **OPTIONS)


def test_rows_are_the_urdf_and_those_asked_for_once(compared: EstimatorComparison) -> None:
    assert [row.name for row in compared.rows] == ["urdf", "physical", "wls", "iv", "smoother"]
    assert compared.joints == tuple(WRONG.joint_names)
    assert compared.recordings == ("day4", "day5")
    assert compared.cutoff_hz == 5.0
    assert compared.condition > 1.0


def assert_same(one: Fit | None, other: Fit) -> None:
    """Sums over threads may differ in their last digits."""
    assert one is not None
    assert one.nmse == pytest.approx(other.nmse, rel=1e-10)
    assert one.rmse == pytest.approx(other.rmse, rel=1e-10)


def test_errors_are_those_of_the_held_out_blocks(compared: EstimatorComparison, recordings: list[Recording]) -> None:
    settings = Settings.from_mapping({**OPTIONS, "estimator": "physical"}, "test")
    prepared = prepare(WRONG, recordings, settings, [effect("viscous_friction")])
    terms = term_candidates(prepared.columns, ["viscous_friction"])
    rows = {row.name: row for row in compared.rows}
    for name in ("physical", "wls"):
        found = estimate(prepared, name, terms)
        assert_same(rows[name].raw, judge(prepared.judging, found.raw))
        assert_same(rows[name].physical, judge(prepared.judging, found.x))
        assert rows[name].was_physical == found.was_physical
    assert_same(rows["urdf"].raw, judge(prepared.judging, prepared.prior.reference))
    assert rows["urdf"].was_physical is None


def test_the_regime_is_that_of_the_filtered_states(compared: EstimatorComparison) -> None:
    assert not compared.noise_matters
    assert compared.regime.statement.endswith("States are filtered.")
    assert compared.doubts == ()


def test_an_estimator_that_cannot_be_used_says_why(compared: EstimatorComparison) -> None:
    row = next(row for row in compared.rows if row.name == "iv")
    assert row.raw is None
    assert row.physical is None
    assert "needs the set-points" in row.note
    assert "day4, day5" in row.note


def test_the_smoother_is_as_good_where_noise_is_small(compared: EstimatorComparison) -> None:
    rows = {row.name: row for row in compared.rows}
    assert rows["smoother"].physical is not None, rows["smoother"].note
    assert rows["physical"].physical is not None
    assert rows["smoother"].physical.mean_nmse == pytest.approx(rows["physical"].physical.mean_nmse, rel=0.1)


def test_one_that_breaks_down_does_not_end_the_comparison(
    recordings: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(prepared, name, terms) -> Estimate:
        if name == "ridge":
            raise RuntimeError("singular\nmatrix")
        return replace(estimate(prepared, "physical", terms), name=name)

    monkeypatch.setattr(comparison, "estimate", broken)
    found = compare_estimators(WRONG, recordings[0], estimators=("ridge", "tls"), cutoff_hz=5.0)
    assert [(row.name, row.note, row.raw is None) for row in found.rows[1:]] == [
        ("ridge", "singular matrix", True),
        ("tls", "", False),
    ]


def test_unknown_estimators_and_options_are_told(recordings: list[Recording]) -> None:
    assert "auto" not in COMPARABLE
    with pytest.raises(OptionError, match="'auto' is either 'physical' or 'smoother', by recording; compare these two"):
        compare_estimators(WRONG, recordings, estimators=["auto"])
    with pytest.raises(OptionError, match=r"unknown estimator 'lassso'; did you mean 'lasso'\?"):
        compare_estimators(WRONG, recordings, estimators=["lassso"])


def test_encoder_noise_for_all_or_some_joints() -> None:
    names = WRONG.joint_names
    for given in (1e-4, "1e-4", ["1e-4"]):
        assert Settings.from_mapping({"encoder_noise": given}, "x").known_encoder_noise(WRONG).tolist() == [1e-4] * 4
    for given in ({names[1]: 2e-4}, [f"{names[1]}=2e-4"], f"{names[1]}=2e-4"):
        found = Settings.from_mapping({"encoder_noise": given}, "x").known_encoder_noise(WRONG)
        assert found.isnan().tolist() == [True, False, True, True]
        assert found[1] == 2e-4
    assert Settings().known_encoder_noise(WRONG).isnan().all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (0.0, "encoder_noise is 0; expected a standard deviation above 0"),
        ({"joint1": -1.0}, "encoder_noise of joint1 is -1; expected"),
        ("small", "encoder_noise is 'small'; expected a number"),
        (["1e-4", "joint1=1e-4"], "expected one number for all joints or JOINT=number"),
        (["joint1=1e-4", "joint1=2e-4"], "each once"),
        ([], "expected one number"),
    ],
)
def test_bad_encoder_noise_is_told(given: object, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        Settings.from_mapping({"encoder_noise": given}, "x")
    with pytest.raises(OptionError, match="has no moving joint 'elbow'"):
        Settings(encoder_noise={"elbow": 1e-4}).known_encoder_noise(WRONG)
