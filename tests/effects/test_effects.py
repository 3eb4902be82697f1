"""One contract for every registered effect."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from effects.sites import ROBOT, SCALE, WINDOW, signals, site_of, states
from torch import Tensor
from torch.autograd import gradcheck

from torchrbd.effects import Effect, Shape, Signals, Site, Term, known_effects
from torchrbd.effects.base import FAMILIES
from torchrbd.export import load_model, save_model
from torchrbd.model import RigidBodyDynamics

URDF_TAGS = {"damping", "friction"}
OF_TWO_SIGNALS = {"smooth_torque_over_qd_of_other_and_own"}
MJCF_ELEMENTS = {"joint", "general", "dcmotor", "actuatorfrc", "fixed", "body", "inertial"}
EXPECTED_IDS = {
    "viscous_friction",
    "coulomb_friction",
    "asymmetric_coulomb_friction",
    "stribeck_friction",
    "quadratic_drag",
    "load_dependent_friction",
    "time_varying_friction",
    "position_dependent_friction",
    "presliding_hysteresis",
    "rotor_inertia",
    "joint_spring",
    "one_sided_spring",
    "torque_ripple",
    "joint_coupling",
    "backlash",
    "joint_elasticity",
    "payload",
    "external_wrench",
    "base_tilt",
    "torque_offset",
    "torque_scale",
    "time_delay",
    "actuator_lag",
    "encoder_offset",
    "geometry_error",
    "power_law_friction",
    "counterbalance",
    "thermal_viscosity",
    "velocity_coupling",
    "coupled_motor",
    "torque_saturation",
    "torque_dead_zone",
    "speed_dependent_loss",
}
ALL = known_effects()


def sizes(effect: Effect, seed: int = 0) -> dict[str, float]:
    """Draw physical parameters: positive, ascending so that friction starts higher than it runs, times in ms.

    Friction changes within some seconds.

    Whose friction a play has is one of two: it is the link's.
    """
    values = np.sort(np.random.default_rng(seed).uniform(0.5, 2.0, len(effect.units)))
    found = dict(zip(effect.units, values.tolist(), strict=True))
    second = 5.0 if effect.of_conditions else 0.02
    found = {name: second * v if effect.unit(name, prismatic=False) == "s" else v for name, v in found.items()}
    return {name: 1.0 if name == "link_friction" else v for name, v in found.items()}


def feature_matrix(effect: Effect, site: Site, shape: Shape, at: Signals) -> Tensor:
    """Return phi (rows, K)."""
    return torch.stack([phi.flatten() for phi in effect.features(at, site, shape).values()], -1)


def term_of(effect: Effect) -> Term:
    w, shape = effect.coefficients(sizes(effect))
    return Term(effect, site_of(effect), torch.tensor(w, dtype=torch.float64), shape)


def test_the_designs_ids_are_registered() -> None:
    assert set(ALL) >= EXPECTED_IDS


@pytest.mark.parametrize("effect", ALL.values(), ids=ALL)
class TestEveryEffect:
    """What all that follows (search, report, export) takes for granted."""

    def test_describes_itself(self, effect: Effect) -> None:
        assert effect.id == effect.id.lower().replace(" ", "_")
        assert effect.words
        assert effect.equation
        assert effect.shown_by.endswith(".")
        assert len(effect.shown_by.split()) < 25
        assert effect.family in set(FAMILIES) - {"unknown"}
        assert effect.prevalence in ("ubiquitous", "common", "rare")
        assert not effect.is_ubiquitous or effect.is_baseline
        w, shape = effect.coefficients(sizes(effect))
        told = shape.keys() & effect.units.keys()
        assert len(effect.units) == len(w) + len(told)
        assert shape.keys() - told <= set(effect.follows)

    def test_units_are_complete(self, effect: Effect) -> None:
        w, shape = effect.coefficients(sizes(effect))
        assert set(effect.parameters(torch.tensor(w), shape)) == set(effect.units)
        for name, pattern in effect.units.items():
            revolute, prismatic = effect.unit(name, prismatic=False), effect.unit(name, prismatic=True)
            assert "{" not in revolute + prismatic
            if "{" in pattern:
                assert "rad" not in prismatic
                assert "N m" not in prismatic
                assert revolute != prismatic

    def test_sites_are_on_the_robot(self, effect: Effect) -> None:
        sites = effect.sites(ROBOT, (WINDOW,))
        assert len(set(sites)) == len(sites) > 0
        for site in sites:
            assert all(j is None or 0 <= j < ROBOT.n_dof for j in (site.joint, site.other))
            assert site.body is None or 0 <= site.body < ROBOT.n_bodies
            assert site.other is None or site.other != site.joint
            assert effect.whole_robot or site.joint is not None
            assert site.window in (None, WINDOW)
        assert len({(s.name(ROBOT), s.window) for s in sites}) == len(sites)

    def test_labels_are_unique_and_hold_for_every_state(self, effect: Effect) -> None:
        seen: dict[tuple[int | None, str], Tensor] = {}
        n_sites = 0
        for site in effect.sites(ROBOT, (WINDOW,)):
            n_sites += 1
            shapes = effect.shapes(SCALE)
            assert shapes
            for shape in shapes:
                features = effect.features(signals(*states(50)), site, shape)
                assert len(features) == len(effect.coefficients(sizes(effect))[0])
                for label, phi in features.items():
                    place = None if effect.whole_robot else site.joint
                    torch.testing.assert_close(seen.setdefault((place, label), phi), phi)
                probe = effect.features(signals(*torch.zeros(3, ROBOT.n_dof, 4, dtype=torch.float64)), site, shape)
                assert tuple(probe) == tuple(features)
        assert len(seen) >= n_sites

    def test_equal_labels_mean_equal_features(self, effect: Effect) -> None:
        at, site = signals(*states(50)), site_of(effect)
        own = effect.features(at, site, effect.shapes(SCALE)[0])
        for other in ALL.values():
            for there in other.sites(ROBOT, (WINDOW,)):
                if other.whole_robot == effect.whole_robot and (effect.whole_robot or there.joint == site.joint):
                    for label, phi in other.features(at, there, other.shapes(SCALE)[0]).items():
                        torch.testing.assert_close(own.get(label, phi), phi)

    @pytest.mark.parametrize("batch", [(4,), (2, 5), (2, 3, 4)])
    def test_features_have_the_shape_and_dtype_of_the_states(self, effect: Effect, batch: tuple[int, ...]) -> None:
        for dtype in (torch.float64, torch.float32):
            at = signals(*(x.to(dtype) for x in states(*batch)))
            for phi in effect.features(at, site_of(effect), effect.shapes(SCALE)[0]).values():
                assert phi.shape == ((ROBOT.n_dof, *batch) if effect.whole_robot else batch)
                assert phi.dtype == dtype

    def test_batched_is_looped(self, effect: Effect) -> None:
        x = states(3, 20)
        term = term_of(effect)
        batched = term(signals(*x))
        for k in range(3):
            torch.testing.assert_close(batched[..., k, :], term(signals(*(v[:, k] for v in x))))

    def test_gradients(self, effect: Effect) -> None:
        x = tuple(v.requires_grad_() for v in states(6))
        term = term_of(effect)
        w = term.coefficients.detach().clone().requires_grad_()

        def torque(q: Tensor, qd: Tensor, qdd: Tensor, w: Tensor) -> Tensor:
            return torch.func.functional_call(term, {"coefficients": w}, (signals(q, qd, qdd),))

        assert gradcheck(torque, (*x, w))
        shape = effect.coefficients(sizes(effect))[1]
        jacobian = torch.autograd.functional.jacobian(lambda w: torch.stack([*effect.parameters(w, shape).values()]), w)
        assert torch.isfinite(jacobian).all()
        assert torch.linalg.matrix_rank(jacobian) == len(w)  # every coefficient shows in a parameter, differentiably

    def test_parameters_and_coefficients_are_inverse(self, effect: Effect) -> None:
        for seed in range(5):
            given = sizes(effect, seed)
            w, shape = effect.coefficients(given)
            back = effect.parameters(torch.tensor(w, dtype=torch.float64), shape)
            assert {k: float(v) for k, v in back.items()} == pytest.approx(given, rel=1e-12)

    def test_term_is_the_weighted_sum_of_features(self, effect: Effect) -> None:
        term, at = term_of(effect), signals(*states(30))
        expected = feature_matrix(effect, term.site, term.shape, at).numpy() @ term.coefficients.detach().numpy()
        np.testing.assert_allclose(term(at).detach().numpy().ravel(), expected, atol=1e-13)
        assert term.parameters_by_name() == pytest.approx(sizes(effect))
        assert effect.id in repr(term)
        assert term(signals(*(v.float() for v in states(30)))).dtype == torch.float32

    def test_recovered_by_plain_least_squares(self, effect: Effect) -> None:
        given = sizes(effect)
        term, at = term_of(effect), signals(*states(400))
        tau = term(at).detach().numpy().ravel()
        w, *_ = np.linalg.lstsq(feature_matrix(effect, term.site, term.shape, at).numpy(), tau, rcond=None)
        found = effect.parameters(torch.from_numpy(w), term.shape)
        assert {k: float(v) for k, v in found.items()} == pytest.approx(given, rel=1e-6)

    def test_in_a_model_and_its_file(self, effect: Effect, tmp_path: Path) -> None:
        term, at = term_of(effect), signals(*states(40))
        if term.site.window is not None:
            pytest.skip("acts in one recording only")
        width = torch.full((ROBOT.n_dof,), SCALE.rest_width, dtype=torch.float64)
        model = RigidBodyDynamics(ROBOT, terms=[term], rest_width=width)
        x = [v.movedim(0, -1) for v in (at.q, at.qd, at.qdd)]
        inputs = {"t": at.t, "temperature": at.temperature.movedim(0, -1)}
        tau = model(*x, **inputs) - ROBOT.inverse_dynamics(*x)
        own = term(at) if effect.whole_robot else term(at).unsqueeze(0)
        there = tau.movedim(-1, 0) if effect.whole_robot else tau[..., term.site.joint].unsqueeze(0)
        torch.testing.assert_close(there, own, rtol=1e-9, atol=1e-9)
        save_model(model, tmp_path / "model.safetensors")
        torch.testing.assert_close(load_model(tmp_path / "model.safetensors")(*x, **inputs), model(*x, **inputs))

    def test_mjcf_or_why_there_is_none(self, effect: Effect) -> None:
        found = effect.mjcf(sizes(effect))
        assert found or effect.export_note
        assert set(found) <= MJCF_ELEMENTS
        for attributes in found.values():
            assert attributes
            for value in attributes.values():
                assert isinstance(value, str) or np.isfinite(value).all()

    def test_prior_agrees_with_what_is_plausible(self, effect: Effect) -> None:
        w, shape = effect.coefficients(sizes(effect))
        assert effect.prior.words.endswith(".")
        assert len(effect.prior.std) in (0, len(w))
        assert all(0 < std < 10 for std in effect.prior.std)
        for k in effect.prior.positive:
            negative = torch.tensor([-v if i == k else v for i, v in enumerate(w)], dtype=torch.float64)
            found = {name: float(v) for name, v in effect.parameters(negative, shape).items()}
            assert not effect.plausible(found, SCALE)

    def test_curve_is_the_torque_over_one_signal(self, effect: Effect) -> None:
        term = term_of(effect)
        shape = effect.shapes(SCALE)[0]
        curve = effect.curve(term.coefficients.detach(), shape, SCALE)
        if curve is None:
            assert effect.whole_robot or effect.id in OF_TWO_SIGNALS
        else:
            assert curve.signal in {"q", "qd", "qdd", "load", "temperature", "t", "q_other", "qd_other"}
            assert curve.x.shape == curve.y.shape
            assert torch.isfinite(curve.y).all()
            assert float(curve.y.abs().max()) > 0
            w = term.coefficients.detach().clone().requires_grad_()
            again = effect.curve(w, shape, SCALE)
            assert again is not None
            again.y.square().sum().backward()
            assert w.grad is not None
            assert (w.grad != 0).any()

    def test_urdf_tags(self, effect: Effect) -> None:
        """What <dynamics> hold is the torque, or a part of it, and the note says which."""
        added, term, at = effect.urdf_dynamics(sizes(effect)), term_of(effect), signals(*states(50))
        assert set(added) <= URDF_TAGS
        assert all(value > 0 for value in added.values())
        if added:
            state = at.joint(term.site.joint)
            written = added.get("damping", 0.0) * state.qd + added.get("friction", 0.0) * state.direction()
            left = (term(at) - written).detach()
            assert bool((left.abs() > 1e-9).any()) == bool(effect.urdf_note)
            assert left.abs().mean() < term(at).abs().mean()
        else:
            assert not effect.urdf_note


DISSIPATIVE = {name: effect for name, effect in ALL.items() if effect.dissipative}


@pytest.mark.parametrize("effect", DISSIPATIVE.values(), ids=DISSIPATIVE)
def test_dissipative_effects_never_drive(effect: Effect) -> None:
    for seed in range(5):
        given = sizes(effect, seed)
        assert effect.plausible(given, SCALE)
        w, shape = effect.coefficients(given)
        site, at = site_of(effect), signals(*states(500, seed=seed))
        tau = Term(effect, site, torch.tensor(w, dtype=torch.float64), shape)(at)
        assert (tau * at.qd[site.joint] >= 0).all()


@pytest.mark.parametrize("effect", DISSIPATIVE.values(), ids=DISSIPATIVE)
def test_negative_friction_is_not_plausible(effect: Effect) -> None:
    given = sizes(effect)
    for name in given:
        if effect.unit(name, prismatic=False).startswith("N m"):
            assert not effect.plausible({**given, name: -0.1}, SCALE), name


@pytest.mark.parametrize("effect", known_effects().values(), ids=lambda e: e.id)
def test_own_signals_are_those_of_the_equation(effect: Effect) -> None:
    """An equation says them too; those of a link are of no one joint."""
    said = dict.fromkeys(re.findall(r"\bq(?:dd?)?\b", effect.equation))
    assert effect.own_signals == (() if effect.id == "external_wrench" else tuple(said))
