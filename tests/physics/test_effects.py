"""One contract for every registered effect."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from torchrbd.physics import Effect, JointScale, JointState, Shape, Term, effects

SCALE = JointScale(speed_max=3.0, rest_width=0.02)
URDF_TAGS = {"damping", "friction"}
EXPECTED_IDS = {
    "viscous_friction",
    "coulomb_friction",
    "asymmetric_coulomb_friction",
    "stribeck_friction",
    "rotor_inertia",
    "joint_spring",
    "torque_offset",
}
ALL = effects()


def sizes(effect: Effect, seed: int = 0) -> dict[str, float]:
    """Draw positive physical parameters in ascending order, so that friction starts higher than it runs."""
    values = np.sort(np.random.default_rng(seed).uniform(0.5, 2.0, len(effect.units)))
    return dict(zip(effect.units, values.tolist(), strict=True))


def states(*shape: int, seed: int = 1, grad: bool = False) -> tuple[Tensor, ...]:
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.uniform(-2, 1.5, shape), rng.uniform(-3, 3, shape), rng.normal(size=shape)
    return tuple(torch.from_numpy(np.asarray(x)).requires_grad_(grad) for x in (q, qd, qdd))


def feature_matrix(effect: Effect, shape: Shape, state: tuple[Tensor, ...]) -> Tensor:
    """Return phi (N, K)."""
    return torch.stack(list(effect.features(JointState(*state, SCALE.rest_width), shape).values()), -1)


def term_of(effect: Effect) -> Term:
    w, shape = effect.coefficients(sizes(effect))
    return Term(effect, 0, torch.tensor(w, dtype=torch.float64), shape, SCALE.rest_width)


def test_the_designs_ids_are_registered() -> None:
    assert set(ALL) >= EXPECTED_IDS


@pytest.mark.parametrize("effect", ALL.values(), ids=ALL)
class TestEveryEffect:
    """What all that follows (search, report, export) takes for granted."""

    def test_describes_itself(self, effect: Effect) -> None:
        assert effect.id == effect.id.lower().replace(" ", "_")
        assert effect.words
        assert effect.equation
        assert effect.complexity == len(effect.units)
        w, shape = effect.coefficients(sizes(effect))
        assert effect.complexity == len(w) + len(shape)

    def test_units_are_complete(self, effect: Effect) -> None:
        w, shape = effect.coefficients(sizes(effect))
        assert set(effect.parameters(torch.tensor(w), shape)) == set(effect.units)
        for name in effect.units:
            revolute, prismatic = effect.unit(name, prismatic=False), effect.unit(name, prismatic=True)
            assert "{" not in revolute + prismatic
            assert "rad" not in prismatic
            assert "N m" not in prismatic
            assert revolute != prismatic

    def test_labels_are_unique_and_hold_for_every_state(self, effect: Effect) -> None:
        shapes = effect.shapes(SCALE)
        assert shapes
        seen: dict[str, Tensor] = {}
        for shape in shapes:
            features = effect.features(JointState(*states(50), SCALE.rest_width), shape)
            assert len(features) == len(effect.coefficients(sizes(effect))[0])
            for label, phi in features.items():
                torch.testing.assert_close(seen.setdefault(label, phi), phi)
            probe = effect.features(JointState(*torch.zeros(3, 1, dtype=torch.float64), 0.1), shape)
            assert tuple(probe) == tuple(features)
        if len(shapes) > 1:
            assert len(seen) > len(shapes)

    def test_equal_labels_mean_equal_features(self, effect: Effect) -> None:
        state = JointState(*states(50), SCALE.rest_width)
        own = effect.features(state, effect.shapes(SCALE)[0])
        for other in ALL.values():
            for label, phi in other.features(state, other.shapes(SCALE)[0]).items():
                torch.testing.assert_close(own.get(label, phi), phi)

    @pytest.mark.parametrize("batch", [(), (1,), (4,), (2, 3), (0,)])
    def test_features_have_the_shape_and_dtype_of_the_states(self, effect: Effect, batch: tuple[int, ...]) -> None:
        for dtype in (torch.float64, torch.float32):
            state = JointState(*(x.to(dtype) for x in states(*batch)), SCALE.rest_width)
            for phi in effect.features(state, effect.shapes(SCALE)[0]).values():
                assert phi.shape == batch
                assert phi.dtype == dtype

    def test_batched_is_looped(self, effect: Effect) -> None:
        x = states(2, 3)
        term = term_of(effect)
        batched = term(*x)
        for index in np.ndindex(2, 3):
            torch.testing.assert_close(batched[index], term(*(v[index] for v in x)))

    def test_gradients(self, effect: Effect) -> None:
        x = states(6, grad=True)
        term = term_of(effect)
        w = term.coefficients.detach().clone().requires_grad_()

        def torque(q: Tensor, qd: Tensor, qdd: Tensor, w: Tensor) -> Tensor:
            return torch.func.functional_call(term, {"coefficients": w}, (q, qd, qdd))

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
        term, x = term_of(effect), states(30)
        expected = feature_matrix(effect, term.shape, x).numpy() @ term.coefficients.detach().numpy()
        np.testing.assert_allclose(term(*x).detach().numpy(), expected, atol=1e-14)
        assert term.parameters_by_name() == pytest.approx(sizes(effect))
        assert effect.id in repr(term)
        assert term(*(v.float() for v in x)).dtype == torch.float32

    def test_recovered_by_plain_least_squares(self, effect: Effect) -> None:
        given = sizes(effect)
        term = term_of(effect)
        x = states(400)
        tau = term(*x).detach().numpy()
        w, *_ = np.linalg.lstsq(feature_matrix(effect, term.shape, x).numpy(), tau, rcond=None)
        found = effect.parameters(torch.from_numpy(w), term.shape)
        assert {k: float(v) for k, v in found.items()} == pytest.approx(given, rel=1e-8)

    def test_urdf_tags(self, effect: Effect) -> None:
        added = effect.urdf_dynamics(sizes(effect))
        assert set(added) <= URDF_TAGS
        assert all(value > 0 for value in added.values())


DISSIPATIVE = {name: effect for name, effect in ALL.items() if effect.dissipative}


@pytest.mark.parametrize("effect", DISSIPATIVE.values(), ids=DISSIPATIVE)
def test_dissipative_effects_never_drive(effect: Effect) -> None:
    for seed in range(5):
        given = sizes(effect, seed)
        assert effect.plausible(given, SCALE)
        w, shape = effect.coefficients(given)
        q, qd, qdd = states(500, seed=seed)
        tau = Term(effect, 0, torch.tensor(w, dtype=torch.float64), shape, SCALE.rest_width)(q, qd, qdd)
        assert (tau * qd >= 0).all()


@pytest.mark.parametrize("effect", DISSIPATIVE.values(), ids=DISSIPATIVE)
def test_negative_friction_is_not_plausible(effect: Effect) -> None:
    given = sizes(effect)
    for name in given:
        if effect.unit(name, prismatic=False).startswith("N m"):
            assert not effect.plausible({**given, name: -0.1}, SCALE), name
