"""Reported errors are the same of blocks and of rows: every row counts alike, of all measured torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from inference.test_sticking import COULOMB, EFFECTS, URDF, Sticky, pendulum

from torchrbd.effects import effect
from torchrbd.inference.physical.fitting import FittedModel, judge
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.series import torque_series
from torchrbd.inference.settings import Settings
from torchrbd.inference.torque_error import Fit
from torchrbd.robot import RobotModel

ROTOR, LATE_S = 0.3, 0.02


def prepared_of(sticky: Sticky, rotor: float = 0.0, **options: Any) -> Prepared:
    settings = Settings.from_mapping({"cutoff_hz": 6.0, "estimator": "physical", "kappa": 0.01, **options}, "test")
    robot = RobotModel.from_urdf(URDF.format(mass=1.7))
    robot.armature[:] = rotor
    return prepare(robot, [sticky.recording], settings, [effect(name) for name in EFFECTS])


def late(sticky: Sticky) -> Prepared:
    prepared = prepared_of(sticky)
    reading = replace(prepared.reading, delay_s={sticky.recording.name: LATE_S})
    return replace(prepared, reading=reading, statistics=reading.statistics(prepared.columns, lambda *_: None))


CASES: dict[str, Callable[[Sticky], Prepared]] = {
    "rows near rest weigh less": prepared_of,
    "states are smoothed": lambda sticky: prepared_of(sticky, estimator="smoother"),
    "a known load": lambda sticky: prepared_of(sticky, payload=["sticky=1.0,0,0,-0.4@arm"]),
    "a known rotor": lambda sticky: prepared_of(sticky, ROTOR),
}


@pytest.fixture(scope="module")
def sticky() -> Sticky:
    return pendulum(5, COULOMB)


def by_rows(prepared: Prepared, model: FittedModel) -> Fit:
    """Return the errors of the held-out rows."""
    module = model.module()
    module.conditions = prepared.reading.conditions
    return torque_series(prepared.reading, {"model": module}, prepared.kept_back).fit("model")


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_blocks_have_the_errors_of_rows(sticky: Sticky, case: Callable[[Sticky], Prepared]) -> None:
    prepared = case(sticky)
    model = prepared.fit(prepared.columns.urdf_friction)
    blocks, rows = judge(prepared.judging, model.x), by_rows(prepared, model)
    assert blocks.nmse == pytest.approx(rows.nmse, rel=1e-3)
    assert blocks.rmse == pytest.approx(rows.rmse, rel=1e-3)


def test_late_torque_moves_the_ends_of_what_is_held_out(sticky: Sticky) -> None:
    """The rows there are others, and no more of them than the delay is long."""
    prepared = late(sticky)
    model = prepared.fit(prepared.columns.urdf_friction)
    held_out_s = sum(block.end_s - block.start_s for block in prepared.judging.blocks)
    nmse = judge(prepared.judging, model.x).nmse
    assert nmse == pytest.approx(by_rows(prepared, model).nmse, rel=10.0 * LATE_S / held_out_s)


def test_a_fit_keeps_its_weights(sticky: Sticky) -> None:
    """Rows near rest weigh less in a fit, and only there."""
    prepared = prepared_of(sticky)
    weight, whole = (float(s.torque[..., 0].sum()) for s in (prepared.training, prepared.judging_fitted))
    assert weight < 0.8 * whole


def test_there_is_no_other_pass_where_a_fit_has_all_rows_alike(sticky: Sticky) -> None:
    prepared = prepared_of(sticky)
    alike = replace(prepared, columns=prepared.columns.unweighted, statistics=prepared.unweighted)
    assert alike.unweighted is alike.statistics
