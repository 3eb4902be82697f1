"""Told effects are recovered, nonlinear parameters and all; the refinement against scipy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import pytest
import scipy.optimize
import torch
from physics.sites import ROBOT, SCALE
from robot.random_robots import random_urdf
from simulated import Motion, inverse_dynamics, joint_names, multisine, with_wrong_inertials

from torchrbd.errors import OptionError
from torchrbd.inference.data.columns import Columns
from torchrbd.inference.identify import identify
from torchrbd.inference.physical.fitting import term_candidates
from torchrbd.inference.physical.terms import term_parameters
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.inference.shapes.places import ToldEffect, told_sites
from torchrbd.inference.shapes.refine import fit_with_shapes, refined
from torchrbd.inference.shapes.slope import Axis, ShapeSlope, axes, slopes
from torchrbd.physics import (
    Effect,
    JointEffect,
    JointScale,
    JointState,
    Shape,
    Signals,
    Site,
    Term,
    Window,
    effects,
    registry,
)
from torchrbd.physics.plain_friction import plain_friction
from torchrbd.physics.stribeck_friction import StribeckFriction
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

ALL = effects()
DURATION_S, CUTOFF_HZ, REST_PART = 25.0, 20.0, 1e-3
LARGEST_PART, LEAST_PART = 0.2, 0.01
WINDOW = Window("simulated", 8.0, 16.0)


class Truth:
    """A random arm with exact states, and the rigid-body torque that Pinocchio finds for them."""

    def __init__(self, seed: int, n_joints: int = 4, duration_s: float = DURATION_S) -> None:
        self.urdf = random_urdf(seed, n_joints, kinds=("revolute",), branching=0.0, massless=0.0)
        self.robot = RobotModel.from_urdf(self.urdf)
        self.given = RobotModel.from_urdf(with_wrong_inertials(self.urdf, seed, 0.1))
        assert list(self.robot.joint_names) == joint_names(self.urdf)
        self.motion = multisine(n_joints, seed, duration_s=duration_s)
        self.rigid = inverse_dynamics(self.urdf, self.motion)
        states = [torch.from_numpy(x.T.copy()) for x in (self.motion.q, self.motion.qd, self.motion.qdd)]
        width = REST_PART * states[1].abs().amax(1)
        rise = torch.from_numpy(1.0 - np.exp(-self.motion.t / 9.0))
        self.temperature = 25.0 + torch.linspace(12.0, 20.0, n_joints, dtype=torch.float64).unsqueeze(1) * rise
        t = torch.from_numpy(self.motion.t)
        self.signals = Signals(self.robot, *states, width, t=t, recording="simulated", temperature=self.temperature)
        self.scales = [
            JointScale(
                float(qd.abs().max()),
                float(rest),
                float(q.min()),
                float(q.max()),
                float(load),
                duration_s,
                (25.0, 45.0),
            )
            for q, qd, rest, load in zip(*states[:2], width, np.abs(self.rigid).max(0), strict=True)
        ]

    def recording(self, added: np.ndarray) -> Recording:
        m: Motion = self.motion
        names, warm = list(self.robot.joint_names), self.temperature.T.numpy()
        return Recording.from_arrays("simulated", names, m.t, m.q, self.rigid + added, temperature=warm)

    def rows(self, effect: Effect, site: Site, shape: Shape) -> np.ndarray:
        """Return the effect's columns (N n_dof, K) in units of the joints' torque, every eighth sample."""
        found = []
        for phi in effect.features(self.signals, site, shape).values():
            whole = (
                phi
                if effect.whole_robot
                else torch.zeros_like(self.signals.q).index_add(0, torch.tensor([site.joint]), phi.unsqueeze(0))
            )
            found.append((whole.T.numpy() / self.rigid.std(0))[::8].reshape(-1))
        return np.stack(found, -1)

    @cached_property
    def imitable(self) -> np.ndarray:
        """Torques that inertial parameters make: an orthonormal basis (N n_dof, rank)."""
        q, qd, qdd = (torch.from_numpy(x[::8]) for x in (self.motion.q, self.motion.qd, self.motion.qdd))
        Y = self.robot.regressor(q, qd, qdd).numpy() / self.rigid.std(0)[:, None]
        Y = Y.reshape(-1, Y.shape[-1])
        U, s, _ = np.linalg.svd(Y / np.linalg.norm(Y, axis=0).clip(1e-12), full_matrices=False)
        return U[:, s > 1e-7 * s[0]]

    def share_left(self, effect: Effect, site: Site, shape: Shape) -> float:
        """Return which part of the effect's least visible combination no inertial parameters can imitate."""
        phi = self.rows(effect, site, shape)
        size = np.linalg.norm(phi, axis=0)
        if not size.all():
            return 0.0
        phi = phi / size
        return float(np.linalg.svd(phi - self.imitable @ (self.imitable.T @ phi), compute_uv=False)[-1])


def between(truth: Truth, effect: Effect, site: Site, rng: np.random.Generator) -> Shape:
    """Return a shape between two in the middle of the grid; a choice, between which nothing lies, stays one."""
    grid = effect.shapes(truth.scales[site.joint or 0])
    drawn = dict(grid[rng.integers(len(grid) // 4, max(3 * len(grid) // 4, 1))])
    for name in drawn:
        values = sorted({shape[name] for shape in grid})
        if len(values) > 1:
            k = min(max(values.index(drawn[name]), len(values) // 4), max(3 * len(values) // 4 - 1, 0))
            low, moved = values[k], {**drawn, name: values[k] + 0.4 * (values[k + 1] - values[k])}
            same = np.array_equal(truth.rows(effect, site, {**drawn, name: low}), truth.rows(effect, site, moved))
            drawn = drawn if same else moved
    return drawn


def drawn(truth: Truth, effect: Effect, seed: int) -> Term:
    """Draw a term where the effect shows best: a shape, and coefficients that the physics allows."""
    rng = np.random.default_rng(seed)
    sites = [s for s in effect.sites(truth.robot, (WINDOW,)) if effect.shapes(truth.scales[s.joint or 0])]
    if not sites:
        pytest.skip(f"never shows: it needs {effect.needs}")
    for _ in range(10):
        shapes = {site: between(truth, effect, site, rng) for site in sites}
        site = max(sites, key=lambda s: truth.share_left(effect, s, shapes[s]))
        if truth.share_left(effect, site, shapes[site]) == 0.0:
            pytest.skip("never shows: it needs a channel that recordings do not hold")
        size = np.sqrt((truth.rows(effect, site, shapes[site]) ** 2).mean(0))
        for part in np.geomspace(LARGEST_PART, LEAST_PART, 60):
            relative = rng.choice((-1, 1), len(size)) * np.exp(rng.uniform(-3, 0, len(size)))
            term = Term(effect, site, torch.from_numpy(part * relative / size), shapes[site])
            if effect.plausible(term.parameters_by_name(), truth.scales[site.joint or 0]):
                return term
    raise AssertionError(f"no plausible {effect.id}")


def stribeck(coulomb: float, extra: float, speed: float, joint: int = 1) -> Term:
    w = torch.tensor([coulomb, extra], dtype=torch.float64)
    return Term(StribeckFriction(), Site(joint), w, {"stribeck_speed": speed})


def added_by(term: Term, truth: Truth) -> np.ndarray:
    """Return the torque of a term (N, n_dof)."""
    with torch.no_grad():
        tau = term(truth.signals)
    if term.effect.whole_robot:
        return tau.T.numpy()
    added = np.zeros_like(truth.rigid)
    added[:, term.site.joint] = tau.numpy()
    return added


def told(term: Term, robot: RobotModel) -> str:
    name = f"{term.effect.id}@{term.site.name(robot)}"
    window = term.site.window
    return name if window is None else f"{name}@{window.recording}={window.start_s:g}:{window.end_s:g}"


def recovered(truth: Truth, terms: list[Term], added: np.ndarray, **options) -> list[dict[str, tuple[float, float]]]:
    settings = Settings(effects=tuple(told(t, truth.robot) for t in terms), cutoff_hz=CUTOFF_HZ, **options)
    chosen = settings.chosen_effects()
    prepared = prepare(truth.given, [truth.recording(added)], settings, chosen)
    candidates = term_candidates(prepared.columns, [e.id for e in chosen])
    prepared, found = refined(prepared, candidates, lambda *_: None)
    model = fit_with_shapes(prepared, found)
    by_place = {(c.effect.id, c.site): c for c in found}
    return [term_parameters(model, by_place[t.effect.id, t.site]) for t in terms]


@pytest.fixture(scope="module")
def arm() -> Truth:
    return Truth(21)


QUICK = {"viscous_friction", "coulomb_friction", "stribeck_friction", "rotor_inertia", "joint_spring"}


@pytest.mark.parametrize(
    "effect", [pytest.param(e, id=name, marks=() if name in QUICK else pytest.mark.slow) for name, e in ALL.items()]
)
def test_every_effect_is_recovered_when_told(effect: Effect, arm: Truth) -> None:
    """From clean data, beside inertial parameters that the URDF has wrong."""
    term = drawn(arm, effect, 1)
    (found,) = recovered(arm, [term], added_by(term, arm))
    assert {k: v for k, (v, _) in found.items()} == pytest.approx(term.parameters_by_name(), rel=0.02)


class Ripple(JointEffect):
    """tau += A sin(m q + phase), as a and b."""

    id, words, equation = "test_ripple", "ripple", "a sin(m q) + b cos(m q)"
    units: ClassVar[Mapping[str, str]] = {"a": "{tau}", "b": "{tau}", "order": "1/{q}"}
    complexity = 3

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return tuple({"order": float(m)} for m in range(5, 25))

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, torch.Tensor]:
        phase = shape["order"] * state.q
        return {f"test sin {shape['order']:.9g}": phase.sin(), f"test cos {shape['order']:.9g}": phase.cos()}

    def parameters(self, coefficients: torch.Tensor, shape: Shape) -> dict[str, torch.Tensor]:
        a, b = coefficients
        return {"a": a, "b": b, "order": coefficients.new_tensor(shape["order"])}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["a"], parameters["b"]), {"order": parameters["order"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return True


class Delay(Effect):
    """tau += share (tau_load(t - delay) - tau_load(t)) of all joints, by linear interpolation."""

    id, words, equation = "test_delay", "delay", "share (tau_load(t - delay) - tau_load(t))"
    units: ClassVar[Mapping[str, str]] = {"share": "1", "delay": "s"}
    complexity, whole_robot, uses_load = 2, True, True

    def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
        return (Site(),)

    def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
        return tuple({"delay": 0.01 * k} for k in range(1, 8))

    def features(self, signals: Signals, site: Site, shape: Shape) -> dict[str, torch.Tensor]:
        t, delay, load = signals.sequence(), shape["delay"], signals.load
        steps = (delay / (t[1] - t[0])).item()
        whole = int(steps)
        shifted = [torch.cat((load[..., :1].expand(*load.shape[:-1], k), load), -1) for k in (whole, whole + 1)]
        n, part = load.shape[-1], steps - whole
        return {f"test delayed {delay:.9g}": (1 - part) * shifted[0][..., :n] + part * shifted[1][..., :n] - load}

    def parameters(self, coefficients: torch.Tensor, shape: Shape) -> dict[str, torch.Tensor]:
        return {"share": coefficients[0], "delay": coefficients.new_tensor(shape["delay"])}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["share"],), {"delay": parameters["delay"]}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return True


@pytest.fixture
def own_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    for one in (Ripple(), Delay()):
        monkeypatch.setitem(registry._EFFECTS, one.id, one)


def test_several_shapes_and_the_load_at_once(arm: Truth, own_effects: None) -> None:
    """A ripple and a Stribeck curve at one joint, a delay of all torques: every parameter within 2 %."""
    scale = float(arm.rigid[:, 1].std())
    terms = [
        Term(Ripple(), Site(1), torch.tensor([0.06, -0.1], dtype=torch.float64) * scale, {"order": 11.37}),
        Term(
            StribeckFriction(), Site(1), torch.tensor([0.2, 0.15], dtype=torch.float64) * scale, {"stribeck_speed": 0.3}
        ),
        Term(Delay(), Site(), torch.ones(1, dtype=torch.float64), {"delay": 0.0137}),
    ]
    found = recovered(arm, terms, sum(added_by(t, arm) for t in terms))
    for term, values in zip(terms, found, strict=True):
        assert {k: v for k, (v, _) in values.items()} == pytest.approx(term.parameters_by_name(), rel=0.02)


def dry(truth: Truth, part: float) -> list[Term]:
    """Return viscous and Coulomb friction of so much of each joint's torque, of all of them."""
    found = []
    for joint, size in enumerate(truth.rigid.std(0)):
        speed = float(truth.signals.qd[joint].std())
        for name, w in (("viscous_friction", part * size / speed), ("coulomb_friction", part * size)):
            found.append(Term(effects()[name], Site(joint), torch.tensor([w], dtype=torch.float64), {}))
    return found


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("time_delay", {"delay": 0.021, "step": 0.021}),
        pytest.param("actuator_lag", {"time_constant": 0.015}, marks=pytest.mark.slow),
        pytest.param("torque_saturation", {"limit": 0.5, "slope": 0.8}, marks=pytest.mark.slow),
    ],
)
def test_what_is_done_to_a_torque_is_done_to_its_friction(name: str, parameters: dict[str, float], arm: Truth) -> None:
    """The effect and the friction of every joint within 2 %."""
    friction, one = dry(arm, 0.2), effects()[name]
    beside = plain_friction(4, [(t.effect.id, t.site.joint, t.coefficients) for t in friction])
    at = replace(arm.signals, friction=beside.detach())
    site = Site() if one.whole_robot else Site(1)
    if "limit" in parameters:
        parameters = {**parameters, "limit": parameters["limit"] * float(at.supplied[1].abs().max())}
    w, shape = one.coefficients(parameters)
    acting = Term(one, site, torch.tensor(w, dtype=torch.float64), shape)
    with torch.no_grad():
        done = acting(at).T.numpy() if one.whole_robot else np.outer(acting(at), np.eye(4)[1])
    terms = [acting, *friction]
    found = recovered(arm, terms, done + sum(added_by(t, arm) for t in friction))
    for t, values in zip(terms, found, strict=True):
        assert {k: v for k, (v, _) in values.items()} == pytest.approx(t.parameters_by_name(), rel=0.02), t


def test_shape_and_its_std_are_those_of_nonlinear_least_squares(arm: Truth) -> None:
    """Against scipy on the dense, filtered rows; few noisy samples, so that the shape is known to some percent."""
    term = stribeck(3.0, 4.0, 0.35)
    noise = 0.1 * arm.rigid.std(0) * np.random.default_rng(3).standard_normal(arm.rigid.shape)
    settings = Settings(effects=(told(term, arm.robot),), cutoff_hz=CUTOFF_HZ, joints=(arm.robot.joint_names[1],))
    prepared = prepare(arm.given, [arm.recording(added_by(term, arm) + noise)], settings, settings.chosen_effects())
    prepared, terms = refined(prepared, term_candidates(prepared.columns, ["stribeck_friction"]), lambda *_: None)
    model = fit_with_shapes(prepared, terms)
    value, _ = term_parameters(model, terms[0])["stribeck_speed"]
    Y, qd, tau, filtered, weights = [], [], [], [], []
    for states in prepared.tiles(0):
        keep = ~prepared.kept_back("simulated", states.t_out)
        rows = prepared.robot.regressor(states.q.T, states.qd.T, states.qdd.T)[:, 1].T
        weight = prepared.columns.stick_weight(states)[1].sqrt()
        weights.append(weight[keep])
        Y.append((weight * states.decimate(rows))[:, keep])
        tau.append((weight * states.decimate(states.tau[1:2]))[:, keep])
        qd.append(states.qd[1])
        filtered.append((states, keep, weight))
    Y_all, tau_all, width = (
        torch.cat(Y, 1).T.numpy(),
        torch.cat(tau, 1)[0].numpy(),
        prepared.columns.scales[1].rest_width,
    )

    def residual(speed: float) -> np.ndarray:
        parts = []
        for (states, keep, weight), v in zip(filtered, qd, strict=True):
            direction = torch.tanh(v / width)
            phi = torch.stack((direction, direction * torch.exp(-((v / speed) ** 2))))
            parts.append((weight * states.decimate(phi))[:, keep])
        A = np.column_stack((Y_all, torch.cat(parts, 1).T.numpy()))
        return tau_all - A @ np.linalg.lstsq(A, tau_all, rcond=1e-9)[0]

    best = scipy.optimize.minimize_scalar(
        lambda v: float((residual(v) ** 2).sum()), bounds=(0.2, 0.6), method="bounded", options={"xatol": 1e-6}
    )
    h, r = 0.01, residual(best.x)
    curvature = sum(float((residual(best.x + s * h) ** 2).sum()) - float((r**2).sum()) for s in (-1, 1)) / h**2
    # Samples are correlated: those of the band count, 2 f_c a second.
    count = float(torch.cat(weights).square().sum())
    share = float(prepared.training.torque[:, 1, 0].sum()) / count
    std = (2.0 * float((r**2).sum()) / count / curvature / share) ** 0.5
    slope = prepared.columns.of(next(c for c in model.terms if isinstance(c, ShapeSlope)))[0]
    at = model.free.tolist().index(slope)
    assert value == pytest.approx(best.x, abs=0.1 * std)
    assert float(model.laplace[at, at]) ** 0.5 == pytest.approx(std, rel=0.15)
    assert abs(value - 0.35) < 4 * std


@pytest.mark.slow
def test_intervals_of_shapes_cover(own_effects: None) -> None:
    """Of 30 fits to noisy recordings, nominal 95 % intervals of all parameters hold the truth in 85 % or more."""
    inside = []
    for seed in range(30):
        truth = Truth(100 + seed, n_joints=3)
        size = float(truth.rigid[:, 1].std())
        terms = [
            Term(Ripple(), Site(1), torch.tensor([0.05, -0.08], dtype=torch.float64) * size, {"order": 11.37}),
            stribeck(2.0, 2.0, 0.3, joint=0),
        ]
        noise = np.random.default_rng(seed).standard_normal(truth.rigid.shape) * 0.1 * truth.rigid.std(0)
        found = recovered(truth, terms, sum(added_by(t, truth) for t in terms) + noise)
        for term, values in zip(terms, found, strict=True):
            for name, given in term.parameters_by_name().items():
                value, std = values[name]
                inside.append(abs(value - given) < 1.96 * std)
    assert np.mean(inside) > 0.85


@pytest.mark.slow
def test_shapes_are_found_from_smoothed_states(arm: Truth) -> None:
    """Position noise that biases filtered states; the shape is refined on the smoothed ones, interval and all."""
    term = stribeck(6.0, 5.0, 0.5)
    rng, m = np.random.default_rng(5), arm.motion
    tau = arm.rigid + added_by(term, arm) + 0.01 * arm.rigid.std(0) * rng.standard_normal(m.q.shape)
    noisy = Recording.from_arrays(
        "simulated", list(arm.robot.joint_names), m.t, m.q + 3e-4 * rng.standard_normal(m.q.shape), tau
    )
    found = identify(arm.given, noisy, effects=told(term, arm.robot), cutoff_hz=8.0, estimator="smoother")
    assert found.states == "smoothed"
    terms = {p.name.rpartition(".")[2]: p for p in found.parameters if p.status == "term"}
    for name, given in term.parameters_by_name().items():
        assert abs(terms[name].value - given) < 4 * terms[name].std + 0.02 * given
        assert terms[name].std < 0.2 * given


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


def test_without_shapes_nothing_is_read_again(arm: Truth) -> None:
    settings = Settings(effects=("viscous_friction",), cutoff_hz=CUTOFF_HZ)
    prepared = prepare(arm.given, [arm.recording(0.0 * arm.rigid)], settings, settings.chosen_effects())
    terms = term_candidates(prepared.columns, ["viscous_friction"])
    again, same = refined(prepared, terms, lambda *_: None)
    assert again is prepared
    assert same == terms


def test_an_estimator_without_intervals_uses_refined_shapes(arm: Truth) -> None:
    term = stribeck(3.0, 4.0, 0.35)
    found = identify(
        arm.given,
        arm.recording(added_by(term, arm)),
        effects=told(term, arm.robot),
        cutoff_hz=CUTOFF_HZ,
        estimator="wls",
    )
    values = {p.name: p for p in found.parameters if p.status == "term"}
    assert values["stribeck_friction_joint2.stribeck_speed"].value == pytest.approx(0.35, rel=0.02)
    assert values["stribeck_friction_joint2.static"].value == pytest.approx(7.0, rel=0.02)


BAD = {
    "stribeck_friction@elbow": r"'stribeck_friction' has no place 'elbow' on robot '.*'; its places are: joint1, ",
    "stribeck_friction@joint22": r"did you mean 'joint2'\?",
    "stribek@joint2": r"unknown effect 'stribek'; known: ",
    "stribeck_friction@": r"effect 'stribeck_friction@': expected EFFECT, EFFECT@PLACE or EFFECT@PLACE@RECORDING",
    "stribeck_friction@joint1@simulated=2:8": r"acts all the time; tell it as stribeck_friction@joint1",
    "stribeck_friction@joint1@other.csv": r"recording 'other.csv', which is none here; there are: simulated",
    "stribeck_friction@joint1@simulated=8:2": r"the end must come after the start",
    "stribeck_friction@joint1@simulated=a:b": r"expected FROM:TO in seconds after 'simulated='",
}


@pytest.mark.parametrize(("given", "message"), BAD.items(), ids=BAD)
def test_places_that_do_not_exist_are_told(given: str, message: str, arm: Truth) -> None:
    with pytest.raises(OptionError, match=message):
        identify(arm.given, arm.recording(0.0 * arm.rigid), effects=given)


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

    timed = ToldEffect(Timed(), "joint2_joint1", Window("a.csv", 2.0, 8.0))
    sites, windows = told_sites([timed, ToldEffect(Ripple(), "joint3")], robot, ["a.csv", "b.csv"])
    assert sites == {"test_ripple": (Site(1, 0, window=windows[0]), Site(2))}
    assert windows == (Window("a.csv", 2.0, 8.0),)
    with pytest.raises(OptionError, match=r"'test_ripple' acts for a time only; tell it as .*@RECORDING="):
        told_sites([ToldEffect(Timed(), "joint2_joint1")], robot, ["a.csv"])
    assert ToldEffect.parse("rotor_inertia@joint3@a.csv=2:").window == Window("a.csv", 2.0)
    assert ToldEffect.parse("rotor_inertia@joint3@a.csv").window == Window("a.csv")
    assert ToldEffect.parse("rotor_inertia") == ToldEffect(ALL["rotor_inertia"])


def test_axes_of_grids() -> None:
    """A product keeps its axes; a grid of another form is thinned to about as many values; a choice has its two."""
    columns = Columns(ROBOT, [], [SCALE] * ROBOT.n_dof)
    candidate = columns.candidate(Ripple(), Site(0), {"order": 7.0})
    axis = axes(columns, candidate)["order"]
    assert axis.values == tuple(map(float, range(5, 25)))
    assert axis.neighbours(7.2) == (6.0, 8.0)
    assert axis.spacing(7.2) == axis.spacing(24.0) == 1.0
    assert axis.limits(5.0) == (4.5, 6.0)
    assert axis.limits(23.9) == (23.0, 24.5)
    assert Axis((0.1, 1.0)).limits(0.1) == pytest.approx((0.05, 1.45))
    assert Axis((3.0,)).spacing(3.0) == Axis((3.0,)).reach == 0.0


def test_slopes_are_derivatives(arm: Truth) -> None:
    columns = Columns(arm.robot, [], arm.scales)
    term = columns.candidate(StribeckFriction(), Site(1), {"stribeck_speed": 0.4})
    (slope,) = slopes(columns, term, torch.tensor([2.0, 3.0], dtype=torch.float64))
    assert slope.belongs_to(term)
    (found,) = slope.features(arm.signals).values()
    qd = arm.motion.qd[:, 1]
    expected = 3.0 * np.tanh(qd / arm.scales[1].rest_width) * np.exp(-((qd / 0.4) ** 2)) * 2 * qd**2 / 0.4**3
    np.testing.assert_allclose(found.numpy(), expected, atol=2e-3 * np.abs(expected).max())


def test_features_that_need_a_sequence_are_left_out_where_there_is_none(arm: Truth) -> None:
    columns = Columns(arm.robot, [Delay(), Ripple()], arm.scales)
    states = [x[:, :50] for x in (arm.signals.q, arm.signals.qd, arm.signals.qdd)]
    found = columns.evaluated(columns.signals_at(*states), columns.candidates)
    assert set(found) == {k for c in columns.candidates if c.effect.id == "test_ripple" for k in columns.of(c)}
