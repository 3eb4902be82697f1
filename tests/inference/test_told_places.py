"""Effects are told their place: at it and nowhere else, and a bad one is answered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import torch
from inference.truths import ALL, CUTOFF_HZ, Ripple, Truth, added_by, stribeck, told
from robot.random_robots import random_urdf

from torchrbd.effects import (
    Site,
    Window,
)
from torchrbd.effects.requested import RequestedEffect, requested_sites
from torchrbd.errors import OptionError
from torchrbd.inference.identify import identify
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel


@pytest.fixture(scope="module")
def arm() -> Truth:
    return Truth(21)


def test_told_place_is_the_only_one(arm: Truth) -> None:
    """Through identify: terms where they were told, series and module agree, other joints have none."""
    term = stribeck(3.0, 4.0, 0.35)
    recording = arm.recording(added_by(term, arm))
    found = identify(arm.given, recording, effects=[told(term, arm.robot), "viscous_friction"], cutoff_hz=CUTOFF_HZ)
    places = {(t.effect.id, t.site.joint) for t in found.model.terms}
    assert places == {("stribeck_friction", 1), *(("viscous_friction", j) for j in range(arm.robot.n_dof))}
    shape = next(t.shape for t in found.model.terms if t.effect.id == "stribeck_friction")
    values = {p.name: p for p in found.parameters if p.status == "term"}
    speed = values["stribeck_friction_joint2.stribeck_speed"]
    assert speed.value == shape["stribeck_speed"] == pytest.approx(0.35, rel=0.02)
    assert 0 < speed.std < 0.02
    series = found.series
    x = [torch.from_numpy(v) for v in (series.q, series.qd, series.qdd)]
    calm = np.abs(series.qd[:, 1]) > 0.3  # where filtering the friction changes nothing
    predicted = found.model(*x).detach().numpy()[calm, 1]
    error = np.sqrt(np.mean((predicted - series.predicted["extended"][calm, 1]) ** 2))
    assert error < 0.02 * np.std(predicted)


BAD = {
    "stribeck_friction@elbow": r"'stribeck_friction' has no place 'elbow' on robot '.*'; its places are: joint1, ",
    "stribeck_friction@joint22": r"did you mean 'joint2'\?",
    "stribek@joint2": r"unknown effect 'stribek'; known: ",
    "stribeck_friction@": r"effect 'stribeck_friction@': expected EFFECT, EFFECT@PLACE or EFFECT@PLACE@RECORDING",
    "stribeck_friction@joint1@simulated=2:8": r"acts all the time; give it as stribeck_friction@joint1",
    "stribeck_friction@joint1@other.csv": r"recording 'other.csv', which is none here; there are: simulated",
    "stribeck_friction@joint1@simulated=8:2": r"the end must come after the start",
    "stribeck_friction@joint1@simulated=a:b": r"expected FROM:TO in seconds after 'simulated='",
}


@pytest.mark.parametrize(("given", "message"), BAD.items(), ids=BAD)
def test_places_that_do_not_exist_are_told(given: str, message: str, arm: Truth) -> None:
    with pytest.raises(OptionError, match=message):
        identify(arm.given, arm.recording(0.0 * arm.rigid), effects=given)


@pytest.mark.slow
def test_an_effect_that_cannot_show_is_told(arm: Truth) -> None:
    m, still = arm.motion, arm.motion.q.copy()
    still[:, 1] = 0.3
    recording = Recording.from_arrays("still", list(arm.robot.joint_names), m.t, still, arm.rigid)
    with pytest.raises(OptionError, match=r"'stribeck_friction' cannot show at joint2 in the range of"):
        identify(arm.given, recording, effects="stribeck_friction@joint2", cutoff_hz=CUTOFF_HZ)


def test_places_of_pairs_and_of_windows() -> None:
    robot = RobotModel.from_urdf(random_urdf(3, 3, kinds=("revolute",), branching=0.0, massless=0.0))

    class Timed(Ripple):
        def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
            return tuple(Site(1, 0, window=w) for w in windows)

    timed = RequestedEffect(Timed(), "joint2_joint1", Window("a.csv", 2.0, 8.0))
    sites, windows = requested_sites([timed, RequestedEffect(Ripple(), "joint3")], robot, ["a.csv", "b.csv"])
    assert sites == {"test_ripple": (Site(1, 0, window=windows[0]), Site(2))}
    assert windows == (Window("a.csv", 2.0, 8.0),)
    offset, pulled = (
        RequestedEffect.parse("torque_offset@joint2"),
        RequestedEffect.parse("torque_offset@joint2@a.csv=2:8"),
    )
    sites, _ = requested_sites([offset, timed], robot, ["a.csv"])
    assert sites["torque_offset"] == (Site(1),)
    sites, _ = requested_sites([offset, pulled, timed], robot, ["a.csv"])
    assert sites["torque_offset"] == (Site(1), Site(1, window=windows[0]))
    with pytest.raises(OptionError, match=r"'test_ripple' acts for a time only; give it as .*@RECORDING="):
        requested_sites([RequestedEffect(Timed(), "joint2_joint1")], robot, ["a.csv"])
    assert RequestedEffect.parse("rotor_inertia@joint3@a.csv=2:").window == Window("a.csv", 2.0)
    assert RequestedEffect.parse("rotor_inertia@joint3@a.csv").window == Window("a.csv")
    assert RequestedEffect.parse("rotor_inertia") == RequestedEffect(ALL["rotor_inertia"])
