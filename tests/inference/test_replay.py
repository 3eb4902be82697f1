"""The saved model is the model that was judged: replayed on the held-out rows it has the reported error."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from effects.sites import ROBOT, SCALE, site_of
from effects.test_effects import sizes
from likelihood.arms import recorded, wrong_robot
from likelihood.fits import OPTIONS, URDF, with_friction
from lxml import etree
from simulated import Motion

import torchrbd
from torchrbd.dataset.columns import Candidate, Columns
from torchrbd.dataset.reading import Reading
from torchrbd.effects import Effect, Site, Window, known_effects
from torchrbd.errors import InputError, OptionError
from torchrbd.export.urdf import not_in_urdf
from torchrbd.inference.physical.fitting import FittedModel, predict
from torchrbd.inference.series import held_out_spans, torque_series
from torchrbd.model import OTHERS, Condition, Reported, RigidBodyDynamics
from torchrbd.recordings import Filtering, Recording, survey

pytestmark = pytest.mark.usefixtures("fit_alone")

EFFECTS = [pytest.param(e, id=e.id) for e in known_effects().values()]
# More rows than a tile has.
CUTOFF_HZ, RATE_HZ, DURATION_S = 5.0, 500.0, 10.0
HELD_OUT = ((2.0, 4.0), (7.0, 8.0))


def moved(name: str, seed: int) -> Recording:
    """Return a recording of the robot that effects are tried at: smooth motion, any torque."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)
    omega, phase = rng.uniform(1.0, 6.0, (3, 4, 1)), rng.uniform(0.0, 6.0, (3, 4, 1))
    q = (0.3 * np.sin(omega * t + phase)).sum(1).T
    tau = np.cumsum(rng.standard_normal(q.shape), 0)
    return Recording.from_arrays(name, list(ROBOT.joint_names), t, q, tau)


def reading_of(recordings: list[Recording]) -> Reading:
    surveys = tuple(survey(r) for r in recordings)
    return Reading(ROBOT, tuple(recordings), surveys, Filtering(CUTOFF_HZ), torch.ones(3, dtype=torch.bool), {})


def in_one(effect: Effect, site: Site) -> Site:
    """Return a site as it is in one recording only, or for a time in it."""
    if site.window is not None:
        return replace(site, window=Window("one", 1.0, 6.0))
    return replace(site, recordings=("one",)) if effect.comes_and_goes else site


def model_of(effect: Effect) -> tuple[FittedModel, Candidate]:
    """Return a fit of ordinary friction and one effect, its load and friction those of the model itself."""
    w, shape = effect.coefficients(sizes(effect))
    columns = Columns(ROBOT, (), [SCALE] * 3)
    one = columns.candidate(effect, in_one(effect, site_of(effect)), shape)
    columns = columns.of_candidates((one,), ROBOT.pi)
    x = columns.reference()
    for friction, value in zip(columns.urdf_friction, np.tile([0.4, 0.6], 3), strict=True):
        x[columns.of(friction)] = float(value)
    x[columns.of(one)] += torch.tensor(w, dtype=torch.float64)
    columns = columns.around(ROBOT.pi, columns.friction_of((*columns.urdf_friction, one), x))
    nothing = torch.zeros(0, 0, dtype=torch.float64)
    terms, free = (*columns.urdf_friction, one), torch.zeros(0, dtype=torch.long)
    return FittedModel(columns, terms, x, free, nothing, nothing, torch.ones(3), True, nothing), one


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect(effect: Effect, tmp_path: Path) -> None:
    """What a fit's columns predict of the held-out rows, its saved model predicts too."""
    fitted, _ = model_of(effect)
    reading = reading_of([moved("one", 1), moved("two", 2)])
    conditions = {"one": Condition(held_out_s=HELD_OUT), "two": Condition(held_out_s=((0.0, DURATION_S),))}
    squares, torques = [], []
    for k in range(2):
        for states in reading.tiles(k):
            tau = states.decimate(states.tau)
            held = conditions[states.recording].held_out(states.t_out)
            torques.append(tau[:, held])
            squares.append((tau - states.decimate(predict(fitted.columns, fitted.x, states)))[:, held] ** 2)
    expected = (torch.cat(squares, 1).mean(1) / torch.cat(torques, 1).var(1, correction=0)).detach()
    model = fitted.module()
    model.conditions, model.reported = conditions, Reported(CUTOFF_HZ, {})
    torchrbd.save_model(model, tmp_path / "model.safetensors")
    found = torchrbd.replay(tmp_path, list(reading.recordings))
    np.testing.assert_allclose(list(found.nmse.values()), expected.numpy(), rtol=1e-6)


def test_conditions_survive_the_file(tmp_path: Path) -> None:
    load = torch.arange(float(ROBOT.n_params), dtype=torch.float64)
    conditions = {
        "one": Condition(0.01, 0.0, load, "sim.csv", HELD_OUT),
        "two": Condition(0.0, 0.03),
        OTHERS: Condition(-0.02),
    }
    model = RigidBodyDynamics(ROBOT, conditions=conditions, reported=Reported(4.0, {"joint1": 0.25}))
    model.save(tmp_path / "m.safetensors")
    back = torchrbd.load_model(tmp_path / "m.safetensors")
    assert back.reported == model.reported
    assert back.conditions.keys() == conditions.keys()
    assert back.conditions["two"] == conditions["two"]
    assert replace(back.conditions["one"], load=None) == replace(conditions["one"], load=None)
    torch.testing.assert_close(back.conditions["one"].load, load)


def test_a_late_torque_is_that_of_before() -> None:
    """A delay reads the torque of earlier states, a lag commands its slope; without a name neither is there."""
    model = RigidBodyDynamics(ROBOT, conditions={"late": Condition(0.02), OTHERS: Condition(0.0, 0.04)})
    t = torch.arange(0.0, 3.0, 0.01, dtype=torch.float64)

    def torque(at: torch.Tensor, name: str | None) -> torch.Tensor:
        phase = torch.tensor([0.0, 1.0, 2.0], dtype=torch.float64)
        x = 2.0 * at.unsqueeze(-1) + phase
        return model(torch.sin(x), 2.0 * torch.cos(x), -4.0 * torch.sin(x), at, recording=name).detach()

    inner, own = slice(5, -5), torque(t, None)
    torch.testing.assert_close(torque(t, "late")[inner], torque(t - 0.02, None)[inner], rtol=1e-6, atol=1e-6)
    slope = torch.gradient(own, spacing=0.01, dim=0)[0]
    torch.testing.assert_close(torque(t, "another")[inner], (own + 0.04 * slope)[inner])
    for name in ("late", "another"):
        back = model.acting_torque(torque(t, name), t, name)
        torch.testing.assert_close(back[100:-5], own[100:-5], rtol=1e-3, atol=2e-3)
    with pytest.raises(InputError, match="the torque of recording 'late' is not that of the same instant"):
        model(torch.zeros(3), torch.zeros(3), torch.zeros(3), recording="late")


@pytest.mark.parametrize("off", [{"delay_s": -0.026}, {"lag_s": 0.04}, {}], ids=["early", "a command", "together"])
def test_identified(off: dict[str, float], tmp_path: Path) -> None:
    """The offset of clocks is in the model, its exports and its error; recordings that it does not know share it."""
    one, two, three = (
        recorded(URDF, seed, with_friction(), name=name, **off, **OPTIONS)
        for seed, name in ((2, "fit"), (5, "other"), (8, "later"))
    )
    found = torchrbd.identify(wrong_robot(URDF, 1), one, holdout=[two])
    torchrbd.save_model(found.model, tmp_path / "model.safetensors")
    again = torchrbd.replay(tmp_path, two)
    assert again.nmse == pytest.approx(found.fits["extended"].nmse, rel=1e-9)
    assert again.reported == again.nmse
    assert max(torchrbd.replay(tmp_path, three).nmse.values()) < 3.0 * max(again.nmse.values())
    model = torchrbd.load_model(tmp_path)
    condition, words = model.conditions[OTHERS], " ".join(torchrbd.not_exported(model))
    assert condition.delay_s == pytest.approx(off.get("delay_s", 0.0), rel=0.05, abs=1e-3)
    assert condition.lag_s == pytest.approx(off.get("lag_s", 0.0), rel=0.05)
    assert bool(re.search(r"recordings fit, other, all others: the torque is 0\.02\d+ s early", words)) is (
        "delay_s" in off
    )
    assert ("a command that actuators follow" in words) is ("lag_s" in off)
    comments = " ".join(str(c.text) for c in etree.fromstring(torchrbd.to_urdf(model)).iter(etree.Comment))
    assert all(one in comments for one in map(str, not_in_urdf(model)) if "recordings" in one)
    if not off:
        return
    model.conditions = {name: one.without_clock() for name, one in model.conditions.items()}
    assert min(torchrbd.replay(model, two).nmse.values()) > 3.0 * max(again.nmse.values())


def test_a_split_within_a_recording(tmp_path: Path) -> None:
    one = recorded(URDF, 2, with_friction(), name="fit", **OPTIONS)
    found = torchrbd.identify(wrong_robot(URDF, 1), one)
    again = torchrbd.replay(found.model, one)
    assert again.nmse == pytest.approx(found.fits["extended"].nmse, rel=1e-9)
    np.testing.assert_array_equal(again.series.held_out, found.series.held_out)
    assert torchrbd.replay(found.model, one, held_out=False).series.held_out.all()


def test_rows_that_rest_count_as_others(tmp_path: Path) -> None:
    """The reported error is the plain mean over all held-out rows."""
    one, two = (recorded(URDF, seed, with_friction(), name=name, **OPTIONS) for seed, name in ((2, "a"), (5, "b")))
    found = torchrbd.identify(wrong_robot(URDF, 1), one, holdout=[two])
    s, fit = found.series, found.fits["extended"]
    error, tau = s.residual("extended")[s.held_out], s.measured[s.held_out]
    expected = np.mean(error**2, 0) / np.var(tau, 0)
    assert fit.nmse == pytest.approx(dict(zip(s.joints, expected, strict=True)), rel=1e-12)


def test_a_known_load(tmp_path: Path) -> None:
    """The load of a recording is in the model under its name, and in no other."""
    robot = torchrbd.RobotModel.from_urdf(URDF)
    link = robot.leaves[0]
    one = recorded(URDF, 2, with_friction(), name="fit", **OPTIONS)

    def carrying(m: Motion) -> np.ndarray:
        extra = torch.zeros(robot.n_params, dtype=torch.float64)
        extra[-10] = 0.8
        x = (torch.from_numpy(np.ascontiguousarray(v)) for v in (m.q, m.qd, m.qdd))
        return with_friction()(m) + robot.inverse_dynamics(*x, extra).numpy()

    two = recorded(URDF, 5, carrying, name="heavy", **OPTIONS)
    found = torchrbd.identify(URDF.encode(), one, holdout=[two], payload=[f"heavy=0.8,0,0,0@{link}"])
    torchrbd.save_model(found.model, tmp_path / "model.safetensors")
    again = torchrbd.replay(tmp_path, two)
    assert again.nmse == pytest.approx(found.fits["extended"].nmse, rel=1e-9)
    assert max(again.nmse.values()) < 5e-3
    assert any("a known load of 0.8 kg" in words for words in torchrbd.not_exported(found.model))
    unloaded = torchrbd.replay(tmp_path, two, payload=["heavy=0.000001,0,0,0@" + link])
    assert max(unloaded.nmse.values()) > 10 * max(again.nmse.values())


def test_a_simulator_that_a_model_lacks_is_asked_for(tmp_path: Path) -> None:
    one, two = (recorded(URDF, seed, with_friction(), name=name, **OPTIONS) for seed, name in ((2, "a"), (5, "b")))
    more = with_friction(lambda m: 0.5 * m.q)
    made = [recorded(URDF, seed, more, name=f"simulated {name}", **OPTIONS) for seed, name in ((2, "a"), (5, "b"))]
    found = torchrbd.identify(URDF.encode(), one, holdout=[two], simulated=made)
    with pytest.raises(OptionError, match="lacks what the simulation 'simulated b' has beyond the URDF in b"):
        torchrbd.replay(found.model, two)
    again = torchrbd.replay(found.model, two, simulated=made[1:])
    assert again.nmse == pytest.approx(found.fits["extended"].nmse, rel=1e-9)
    assert any(
        "what the simulation simulated b has beyond the URDF" in words for words in torchrbd.not_exported(found.model)
    )


def test_spans_hold_the_rows_that_are_held_out() -> None:
    reading = reading_of([moved("one", 1), moved("two", 2)])
    rng = np.random.default_rng(0)
    kept = {name: rng.random(101) < 0.5 for name in ("one", "two")}

    def held(name: str, t: torch.Tensor) -> torch.Tensor:
        return torch.from_numpy(kept[name][(10 * t).long().numpy()])

    series = torque_series(reading, {}, held)
    for k, (name, spans) in enumerate(held_out_spans(series).items()):
        here = series.recording == k
        t = torch.from_numpy(series.t[here])
        np.testing.assert_array_equal(Condition(held_out_s=spans).held_out(t).numpy(), series.held_out[here])
        assert series.recordings[k] == name


def test_what_cannot_be_replayed() -> None:
    one = recorded(URDF, 2, with_friction(), name="fit", **OPTIONS)
    model = RigidBodyDynamics(torchrbd.RobotModel.from_urdf(URDF), conditions={"fit": Condition()})
    with pytest.raises(OptionError, match="no row is held out; give recordings that it was not fitted to"):
        torchrbd.replay(model, one)


def test_simulation_has_the_torque_at_the_time_of_the_motion() -> None:
    """Under a torque that is early the motion is lost sooner unless the model knows that it is."""
    early = recorded(URDF, 5, with_friction(), name="early", delay_s=-0.03, **OPTIONS)
    found = torchrbd.identify(wrong_robot(URDF, 1), recorded(URDF, 2, with_friction(), delay_s=-0.03, **OPTIONS))
    known = torchrbd.simulate(found.model, early, start=2.0, seconds=0.5)
    found.model.conditions = {}
    unknown = torchrbd.simulate(found.model, early, start=2.0, seconds=0.5)
    assert sum(known.distance.values()) < 0.5 * sum(unknown.distance.values())
