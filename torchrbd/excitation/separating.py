"""How well a motion distinguishes effects: the expected log Bayes factor of a recording of it.

Torques, whitened by the noise that was learnt, are those of nuisances Z (inertial parameters around the URDF's,
friction of every joint and all other terms of any size; z ~ N(0, 1)) and of one rival A or B, w_A ~ N(0, D_A^2):
tau = Z z + Phi_A w_A + n. With M = 1 + Z'Z,

    S_AB = Phi_A' Phi_B - Phi_A' Z M^-1 Z' Phi_B                   what nuisances cannot absorb
    E_A[log B_H] = 1/2 w_A' S_AH D_H K_H^-1 D_H S_HA w_A + 1/2 (k - tr K_H^-1) - 1/2 log det K_H,
    K_H = 1 + D_H S_HH D_H

is the expected evidence of H against neither if A is true with coefficients w_A. The log Bayes factor of A against B is
the difference E_A[log B_A] - E_A[log B_B], for the new recording alone. A rival's nonlinear shape may change by a
fifth: the slopes of its torque by the shape are columns too.

Source: MacKay, "Information Theory, Inference, and Learning Algorithms" (2003), ch. 28, for the evidence; its
    expectation by E[x'Ax] = tr(A cov(x)) + E[x]'A E[x].
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchrbd.effects import Signals
from torchrbd.effects.plain_friction import plain_friction
from torchrbd.excitation.conditioning import REST_PART, Conditioning
from torchrbd.excitation.limits import Limits
from torchrbd.excitation.results import Separation
from torchrbd.excitation.rivals import Known, Question, Rival, other_terms
from torchrbd.likelihood.coefficient_prior import inertial_scale

# Coefficients may be so many times what the first recordings gave; a shape may differ by this part; slopes by steps.
_SIZE, _SHAPE, _STEP = 3.0, 0.2, 0.01
_LEAST, _ANY_SIZE, _ROUNDING = 1e-12, 1e4, 1e-12
# A condition number e times as large is worth this part of what separates.
_CONDITION = 0.1


class Separating:
    """The questions that a motion is to answer.

    Args:
        known: what is known of the robot.
        limits: say which joints move.
        conditioning: of the same motion.
        t: (N,) times of one period, evenly spaced [s].
        periods: how often it is recorded.
        periodic: whether the samples are a whole period, so that what is beyond the cut-off can be taken off.
    """

    def __init__(
        self,
        known: Known,
        limits: Limits,
        conditioning: Conditioning,
        t: Tensor,
        periods: int,
        *,
        periodic: bool = True,
    ) -> None:
        self.known, self.t, self._conditioning = known, t, conditioning
        seen = known.noise_std.isfinite() & limits.moves
        self._rows = seen.nonzero().flatten().tolist()
        duration = periods * len(t) * float(t[1] - t[0])
        independent = 2.0 * known.cutoff_hz * duration / len(t)
        self._weight = independent**0.5 / known.noise_std[self._rows]
        self._rest_width = torch.maximum(known.model.rest_width, REST_PART * limits.fastest)
        mean, index, scale = inertial_scale(known.model.robot)
        self._inertial = torch.zeros(len(mean), len(index), dtype=torch.float64)
        self._inertial[index] = torch.from_numpy(scale)
        self._kept = None
        if periodic:
            self._kept = torch.fft.rfftfreq(len(t), float(t[1] - t[0]), dtype=torch.float64) <= known.cutoff_hz

    def objective(self, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return the negative mean of log(1 + L), L the expected log Bayes factors, and a little of the condition."""
        parts = [self.log_bayes_factors(question, q, qd, qdd) for question in self.known.questions]
        pairs = torch.cat([L[~torch.eye(len(L), dtype=torch.bool)] for L in parts])
        gained = torch.log1p(torch.nn.functional.softplus(pairs)).mean()
        return _CONDITION * self._conditioning.objective(q, qd, qdd) - gained

    def log_bayes_factors(self, question: Question, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return the expected log Bayes factor of each rival, if it is true, against each other one (R, R) [nats].

        Args:
            question: whose rivals.
            q, qd, qdd: (N, n) states at the times.
        """
        signals = self._signals(q, qd, qdd)
        Z = self._nuisances(question, signals, q, qd, qdd)
        columns = [self._columns(rival, signals) for rival in question.rivals]
        Phi, sizes = torch.cat([c for c, _ in columns]), [size for _, size in columns]
        S = _schur(Z, Phi)
        ends = torch.tensor([len(s) for s in sizes]).cumsum(0).tolist()
        at = [range(end - len(s), end) for end, s in zip(ends, sizes, strict=True)]
        evidence = torch.stack(
            [
                torch.stack(
                    [_expected(S, own, rival.coefficients, where, D) for where, D in zip(at, sizes, strict=True)]
                )
                for own, rival in zip(at, question.rivals, strict=True)
            ]
        )
        return evidence.diagonal().unsqueeze(1) - evidence

    def separations(self, q: Tensor, qd: Tensor, qdd: Tensor) -> tuple[Separation, ...]:
        """Return what a motion is expected to say of every pair of rivals."""
        found = []
        for question in self.known.questions:
            L = self.log_bayes_factors(question, q, qd, qdd)
            for i, one in enumerate(question.rivals):
                for k, other in enumerate(question.rivals[:i]):
                    gain = float(torch.minimum(L[i, k], L[k, i]))
                    prior = min(one.probability, other.probability) / max(one.probability + other.probability, _LEAST)
                    odds = torch.logit(torch.tensor(prior, dtype=torch.float64), eps=_LEAST) + gain
                    found.append(Separation(other.words, one.words, gain, prior, float(torch.sigmoid(odds))))
        return tuple(found)

    def _signals(self, q: Tensor, qd: Tensor, qdd: Tensor) -> Signals:
        model = self.known.model
        plain = ((x.effect, x.site.joint, x.coefficients) for x in model.terms if x.site.always)
        friction = plain_friction(model.robot.n_dof, plain)
        q, qd, qdd = (x.T.contiguous() for x in (q, qd, qdd))
        return Signals(model.robot, q, qd, qdd, self._rest_width, model.pi, self.t, friction=friction)

    def _nuisances(self, question: Question, signals: Signals, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return Z (P, rows N): inertial parameters, friction in each direction, and terms that are not in question."""
        Y = (signals.robot.regressor(q, qd, qdd) @ self._inertial).permute(2, 1, 0)
        direction = torch.tanh(signals.qd / self._rest_width.unsqueeze(1))
        each = torch.eye(len(q.T), dtype=q.dtype)
        friction = [each.unsqueeze(2) * x for x in (signals.qd, direction, direction.abs())]
        terms = [
            self._placed(phi, term.site.joint)
            for term in other_terms(self.known.model, question)
            for phi in term.effect.features_at(signals, term.site, term.shape).values()
        ]
        free = self._white(torch.cat((*friction, *(x.unsqueeze(0) for x in terms))))
        size = free.square().sum(1, keepdim=True).sqrt().clamp_min(_LEAST)
        return torch.cat((self._white(Y), _ANY_SIZE * free / size))

    def _columns(self, rival: Rival, signals: Signals) -> tuple[Tensor, Tensor]:
        """Return a rival's columns (K, rows N), those of its shape last, and their prior standard deviations (K,)."""
        if rival.effect is None:
            return self.t.new_zeros(0, len(self._rows) * len(self.t)), self.t.new_zeros(0)
        w = rival.coefficients

        def features(shape: dict[str, float]) -> Tensor:
            assert rival.effect is not None
            found = rival.effect.features(signals, rival.site, shape).values()
            return torch.stack([self._placed(phi, None if phi.ndim > 1 else rival.site.joint) for phi in found])

        own, slopes = features(dict(rival.shape)), []
        for name, value in rival.shape.items():
            further = features({**rival.shape, name: value * (1.0 + _STEP)})
            slopes.append(torch.tensordot(w, further - own, 1) / _STEP)
        columns = torch.cat((own, torch.stack(slopes))) if slopes else own
        size = _SIZE * w.abs().clamp_min(_LEAST * float(w.abs().max()))
        return self._white(columns), torch.cat((size, torch.full((len(slopes),), _SHAPE, dtype=torch.float64)))

    def _placed(self, phi: Tensor, joint: int | None) -> Tensor:
        """Return a feature as torques of all joints, (n, N)."""
        if joint is None or phi.ndim > 1:
            return phi
        each = torch.zeros(self.known.model.robot.n_dof, 1, dtype=phi.dtype)
        each[joint] = 1.0
        return each * phi

    def _white(self, columns: Tensor) -> Tensor:
        """Return columns (K, n, N) at the joints that count, below the cut-off, over the noise, (K, rows N)."""
        own = columns[:, self._rows]
        if self._kept is not None:
            own = torch.fft.irfft(torch.fft.rfft(own) * self._kept, n=len(self.t))
        return (own * self._weight.unsqueeze(1)).flatten(1)


def _schur(Z: Tensor, Phi: Tensor) -> Tensor:
    """Return Phi Phi' - Phi Z' (1 + Z Z')^-1 Z Phi' of rows Z (P, M) and Phi (K, M)."""
    M = torch.eye(len(Z), dtype=Z.dtype) + Z @ Z.T
    size = M.diagonal().rsqrt().unsqueeze(1)
    F = torch.linalg.cholesky(size * M * size.T + _ROUNDING * torch.eye(len(Z), dtype=Z.dtype))
    V = torch.linalg.solve_triangular(F, size * (Z @ Phi.T), upper=False)
    return Phi @ Phi.T - V.T @ V


def _expected(S: Tensor, true: Sequence[int], w: Tensor, at: Sequence[int], std: Tensor) -> Tensor:
    """Return the expected log evidence of columns ``at`` if the first of ``true`` act with coefficients w."""
    own = list(true)[: len(w)]
    r = std * (S[list(at)][:, own] @ w)
    K = torch.eye(len(std), dtype=S.dtype) + std.unsqueeze(1) * S[list(at)][:, list(at)] * std
    L = torch.linalg.cholesky(K)
    inverse = torch.cholesky_inverse(L)
    freedom = len(std) - inverse.diagonal().sum()
    return 0.5 * (r @ inverse @ r + freedom) - L.diagonal().log().sum()
