"""Check the ranking of what a URDF may leave out, from files' contents to the order of hypotheses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from likelihood.arms import recorded
from likelihood.fits import DELAY_S, OPTIONS, URDF, at_joint, fitted, with_friction
from simulated import joint_names, with_wrong_inertials

from torchrbd.diagnosis.ranked import Ranking
from torchrbd.diagnosis.ranking import _of_all, rank_hypotheses
from torchrbd.effects.registry import known_effects
from torchrbd.errors import InputError
from torchrbd.likelihood.clocks import Clocks

GIVEN = with_wrong_inertials(URDF, 1, 0.1).encode()
FIRST, SECOND = joint_names(URDF)
LATE = ("time_delay", ())
SURE = math.log(9.0)
ORDER, AMPLITUDE, INERTIA = 17.4, 0.08, 0.05
CONCEALED = at_joint(1, lambda m: AMPLITUDE * np.sin(ORDER * m.q[:, 1] + 0.7) + INERTIA * m.qdd[:, 1])


@pytest.fixture(scope="module")
def found() -> Ranking:
    """Return the ranking of an arm with two concealed effects; another recording is held out."""
    recording = recorded(URDF, 2, with_friction(CONCEALED), delay_s=DELAY_S, **OPTIONS)
    other = recorded(URDF, 5, lambda m: 50.0 + 0.0 * m.q, name="other", **OPTIONS)
    return rank_hypotheses(GIVEN, recording, holdout=[other])


@pytest.mark.parametrize(("late_s", "may"), [(0.004, {"time_delay"}), (-0.004, {"time_delay", "actuator_lag"})])
def test_torque_that_all_joints_have_early_may_be_a_delay_or_a_lag(late_s: float, may: set[str]) -> None:
    clocks = Clocks(fitted(), {"simulated": late_s})
    found = _of_all(clocks, list(known_effects().values()))
    assert {h.effect for h in found} == may
    for h in found:
        assert (h.joints, h.log_evidence) == ((), clocks.against)
        assert abs(h.parameters["delay" if h.effect == "time_delay" else "time_constant"]) == pytest.approx(
            0.004, abs=1e-3
        )
        assert h.effect == "time_delay" or h.parameters["time_constant"] > 0


@pytest.fixture(scope="module")
def nothing() -> Ranking:
    """Return the ranking of an arm without any effect."""
    return rank_hypotheses(GIVEN, recorded(URDF, 2, with_friction(), **OPTIONS))


def test_what_is_there_is_adopted_and_nothing_else(found: Ranking) -> None:
    assert {(h.effect, h.joints) for h in found.adopted} == {("torque_ripple", (SECOND,)), ("rotor_inertia", (SECOND,))}
    (late,) = (h for h in found.first[:4] if h.effect == "time_delay")
    best = next(h for h in found.first if h is not late)
    assert (late.effect, late.joints, late.links) == ("time_delay", (), ())
    assert late.parameters["delay"] == pytest.approx(DELAY_S, abs=3.0 * found.delay_s["simulated"][1])
    assert best.effect == found.adopted[0].effect
    for h in found.adopted:
        assert h.log_evidence > 30
        match h.effect:
            case "torque_ripple":
                assert h.parameters["amplitude"] == pytest.approx(AMPLITUDE, rel=0.1)
                assert h.parameters["order"] == pytest.approx(ORDER, abs=0.1)
                assert h.shape["order"] == h.parameters["order"]
            case _:
                assert h.parameters["rotor_inertia"] == pytest.approx(INERTIA, rel=0.1)


def test_beside_what_was_adopted_nothing_is_sure(found: Ranking) -> None:
    adopted = {(h.effect, h.joints) for h in found.adopted}
    last = [h for h in found.last if (h.effect, h.joints) not in {*adopted, LATE}]
    assert len(last) > 20
    assert all(h.log_evidence < math.log(found.considered) + SURE for h in last)
    assert {(h.effect, h.joints) for h in found.last[:3]} == {*adopted, LATE}
    for hypotheses in (found.first, found.last):
        assert [h.log_evidence for h in hypotheses] == sorted((h.log_evidence for h in hypotheses), reverse=True)


def test_evidence_of_the_truth_is_about_that_of_the_ranking(found: Ranking, nothing: Ranking) -> None:
    best = next(h for h in found.first if h.effect == "torque_ripple")
    told = found.evidence_of("torque_ripple", [SECOND], shape={"order": ORDER})
    # The order is known and need not be paid for.
    assert best.log_evidence < told + 3
    # It does not lead, so that bodies and friction are not learnt anew beside it.
    assert told < 1.5 * best.log_evidence
    assert found.evidence_of("torque_ripple", [SECOND], shape={"order": 9.3}) < 8
    # Beside a model that lacks both effects, others make up for a part; beside one that lacks nothing, none does.
    assert found.evidence_of("quadratic_drag", [FIRST]) < 0.1 * told
    assert nothing.evidence_of("quadratic_drag", [FIRST]) < 8
    assert found.evidence_of(effect="quadratic_drag", joints=[FIRST]) == pytest.approx(
        found.evidence_of("quadratic_drag", [FIRST])
    )


def test_evidence_is_told_of_every_kind_of_place(found: Ranking, nothing: Ranking) -> None:
    link = nothing.evidence_of("payload", links=["link2"], window=("simulated", 5.0, 9.0))
    assert link < 8
    assert np.isfinite(found.evidence_of("base_tilt"))
    assert np.isfinite(found.evidence_of("joint_coupling", [FIRST], shape={"other": SECOND}))
    assert found.evidence_of("payload", links=["link2"], window=("no such recording", 5.0, 9.0)) == -math.inf


def test_ordinary_friction_and_clock_are_told(found: Ranking) -> None:
    by = {(h.effect, h.joints[0]): h for h in found.ordinary}
    assert len(by) == 4
    for joint, viscous, coulomb in ((FIRST, 0.4, 1.0), (SECOND, 0.2, 0.3)):
        rubbed = by["asymmetric_coulomb_friction", joint]
        assert by["viscous_friction", joint].parameters["viscous"] == pytest.approx(viscous, rel=0.1)
        assert list(rubbed.parameters.values()) == pytest.approx([coulomb, coulomb], rel=0.1)
        assert rubbed.shape["width"] == pytest.approx(0.05, rel=0.5)
        assert rubbed.log_evidence > 30
    assert set(found.delay_s) == {"simulated"}
    delay, std = found.delay_s["simulated"]
    assert delay == pytest.approx(DELAY_S, abs=max(4 * std, 2e-4))


def test_clocks_that_are_far_apart_are_brought_together() -> None:
    """All torques come 30 ms late, three samples: they are read again by so much earlier."""
    recording = recorded(URDF, 2, with_friction(), delay_s=0.03, **OPTIONS)
    late = rank_hypotheses(GIVEN, recording, effects=["time_delay", "rotor_inertia", "joint_spring"])
    assert late.delay_s["simulated"][0] == pytest.approx(0.03, abs=5e-4)
    first = late.first[0]
    assert (first.effect, first.joints, first.links) == ("time_delay", (), ())
    assert first.parameters["delay"] == pytest.approx(0.03, abs=5e-4)
    assert first.log_evidence == late.evidence_of("time_delay") > 100
    assert late.adopted == ()
    for h in late.ordinary:
        if "viscous" in h.parameters:
            assert h.parameters["viscous"] == pytest.approx({FIRST: 0.4, SECOND: 0.2}[h.joints[0]], rel=0.1)


def test_recording_that_is_held_out_says_nothing_of_the_band(found: Ranking) -> None:
    """Its clock is so slow that no filter of the ranking would pass it, its speed and noise larger."""
    recording = recorded(URDF, 2, with_friction(), **{**OPTIONS, "duration_s": 10.0})
    slow = recorded(URDF, 5, name="slow", **{**OPTIONS, "rate_hz": 20.0, "fastest_hz": 3.0, "encoder_noise": 1e-3})
    some = {"effects": ["rotor_inertia", "quadratic_drag"]}
    with_it, without = (
        rank_hypotheses(GIVEN, recording, holdout=[slow], **some),
        rank_hypotheses(GIVEN, recording, **some),
    )
    assert with_it.band_hz == without.band_hz
    assert with_it.first == without.first
    assert with_it.delay_s == without.delay_s


def test_recording_that_is_held_out_is_not_looked_at(found: Ranking) -> None:
    """Its torque of 50 N m would be all that is seen."""
    assert found.band_hz == pytest.approx(12.0, rel=0.01)
    assert all(h.window is None or h.window[0] == "simulated" for h in found.first)


def test_effects_that_are_chosen_are_the_only_ones() -> None:
    recording = recorded(URDF, 2, with_friction(), **{**OPTIONS, "duration_s": 10.0})
    told: list[float] = []
    some = rank_hypotheses(
        GIVEN, recording, effects=["rotor_inertia", "base_tilt"], progress=lambda _, part: told.append(part)
    )
    assert {h.effect for h in some.first} == {"rotor_inertia", "base_tilt"}
    assert some.considered == 3
    assert some.adopted == ()
    laws = [h.effect for h in some.last if not h.effect.startswith(("smooth_", "hum"))]
    assert laws == [h.effect for h in some.first]
    assert told
    assert 0.0 <= min(told) <= max(told) <= 1.0


def test_input_that_cannot_be_used_is_refused(found: Ranking) -> None:
    recording = recorded(URDF, 2, **{**OPTIONS, "duration_s": 5.0})
    with pytest.raises(InputError, match="no effect is left"):
        rank_hypotheses(GIVEN, recording, effects=["base_tilt"], exclude=["base_tilt"])
    with pytest.raises(InputError, match="joint9"):
        rank_hypotheses(GIVEN, recording, joints=["joint9"])
    with pytest.raises(InputError, match="no_such_effect"):
        found.evidence_of("no_such_effect", [FIRST])
