"""The baseline model, as columns of each joint's rows: rigid body and terms that are always fitted.

    tau_j = Y_j pi                                          rigid body, around the URDF
          + d qd + c_+ max(g, 0) + c_- min(g, 0)            viscous and two-sided Coulomb friction, g = tanh(qd / w)
          + s dg/dlog w + l d(c g)/dt + r d^2(c g)/dt^2     width, delay and duration of the sign change
          + sum_i f_i c (g'_i - g)                          friction that holds the joint at rest, see below
          + h sum_e (sum_k h_ek u_e(t) cos(k pi s_e) / (1 + k) + t_e dg/dt)
                                                            each rest or reversal e, with s_e from 0 to 1 during it:
                                                            the friction that holds it, and the time of its change
          + t0 d(tau_s)/dt + (t1 + t_j b) F d(tau_load)/dt  clock offset t0 of torque and motion; F is the high-
                                                            frequency part, less informative because of its noise;
                                                            b is 1 where any joint breaks away
          + sum_k dtau/dq_k s + dtau/dqd_k s' + dtau/dqdd_k s'',  s = a_k d^2q_k/dt^2 + b_k d^4q_k/dt^4
                                                            correction of the fastest part of each joint's motion
          + b sin(2 pi tau_s / D) + b' cos(2 pi tau_s / D)  rounding, if the torque is recorded in steps D
          + drift(t)                                        the lowest frequencies of a random walk, and its level,
                                                            which is no larger: a larger one is an offset

*Fast motion.* The fastest part of the differentiated positions is both motion and encoder noise. The torques of all
joints identify the share of motion, joint by joint: q + a d^2q/dt^2 is q with its highest frequencies attenuated
(regression calibration: Carroll et al., "Measurement Error in Nonlinear Models", 2006, ch. 4). The states' filter has
one gain W(f) for all time and for each joint alone: the motion's mean share of the power. But near the band's edge
motion comes in bursts. When dry friction reverses, it accelerates all joints at once for some hundredths of a second;
between reversals there is only noise. The gain that fits the rows differs from W by an even function of the frequency;
a and b are its first two terms. With a alone, the error of W was taken for an elasticity of the transmission, which
amplifies high frequencies and has both terms: 156 nats for one that did not exist. There were none without friction,
and none without noise in the positions. W does not change slow motion, so a and b do not either.

The high-frequency part of a load is such noise, too. When a joint breaks away, smoothed positions do not show it. The
high-frequency part of all loads then seems to have a delay of each joint's own (t_j), which is not that of the clocks.

*Friction at rest.* Friction has sharp edges, with one exception. At a reversal a joint rests while its friction changes
from one side to the other; the smoothed positions do not show this. The drive pushes harder until the joint breaks
away, so friction follows a straight line: g' is g with straight lines across rests, for shorter and longer rests. Their
share f depends on the drive: a joint that passes through zero speed does not rest. At each rest, friction is an unknown
torque within its limits (h, at least as large as in motion): one unknown for a reversal, several for a long rest. The
time of its change is known to a fraction of a sample (t).

*Rounding.* Its error is a function of the torque, a sawtooth that noise smooths to its first harmonic (Widrow and
Kollar, "Quantization Noise", 2008).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from scipy.ndimage import maximum_filter1d
from scipy.special import ndtri
from torch import Tensor

from torchrbd.effects import Signals
from torchrbd.effects.band_limits import below, flat_below
from torchrbd.likelihood.hyper import Hyper
from torchrbd.likelihood.noise import drift_basis, predicted
from torchrbd.likelihood.resting import moving
from torchrbd.likelihood.rows import Rows
from torchrbd.likelihood.sizes import inertial_scale

# Frequency below which derivatives of the load count as slow [Hz]: above, noise of the positions dominates them.
OFFSET_HZ = 6.0
# Prior standard deviation of the clock offset, in samples.
_TIMING_SAMPLES = 3.0
# Rows per period of the band's edge; fraction of that edge above which motion is fast; number of gain terms; least gain
# of the states' filter that counts.
_EDGE_ROWS, _FAST, _FASTEST, _LEAST_GAIN = 2.5, 0.25, 2, 0.1
_ROUNDING = 2
# Prior standard deviation of the duration of a sign change, in rows: about the resolution of the band.
_LASTING_ROWS = 0.5
# A joint rests, or reverses, where its direction is this uncertain, with the velocity's error multiplied by
# _REST_STICK. Only the _MOST_RESTS longest rests per joint have terms of their own.
_RESTS, _REST_STICK, _MOST_RESTS = 0.05, 3.0, 30
# Its speed is then below this, in standard deviations of its error: 2 sqrt(p (1 - p)) = r for p = (1 - sqrt(1 - r^2)) /
# 2.
_SLOW = -float(ndtri(0.5 * (1.0 - math.sqrt(1.0 - _RESTS**2))))
# Highest frequency of the friction in a long rest [Hz]; largest number of such unknowns per joint.
_HOLDS_HZ, _MOST_HOLDS = 5.0, 60
# Standard deviation of the time at which friction changes, in samples; reach of its effect around that time or a rest
# [rows].
_TURNS_SAMPLES, _FELT_ROWS = 0.5, 6
# Prior standard deviation of the relative width of friction's sign change, and step of its central difference.
_WIDTH_STD, _WIDTH_STEP = 0.5, 1.1
# Number of cached widths of sign changes, the most recent ones.
_MOST_DIRECTIONS = 256
# Highest frequency of drift [Hz], and largest number of its cosines per recording.
DRIFT_HZ, MOST_DRIFT = 0.1, 12
# A joint counts as sticking below these multiples of its velocity's error: it creeps, and its friction is unknown.
STICKS = (1.0, 3.0, 10.0)
ORDINARY = ("viscous", "coulomb_plus", "coulomb_minus")
# Effects in the baseline model.
ORDINARY_EFFECTS = ("viscous_friction", "asymmetric_coulomb_friction")


class Machine:
    """Columns of the baseline model on one set of rows; coefficients have the prior N(0, 1).

    Args:
        rows: the data.
        held: bodies whose inertia is not fitted.

    Attributes:
        n: number of coefficients.
        torque_rms: (n_dof,) of the measured torque [N m or N].
        moving: (n_dof,) joints that ever move; the others have no columns from their own motion.
        index: per joint, the rows (m,) that are whitened.
    """

    def __init__(self, rows: Rows, held: frozenset[str] = frozenset()) -> None:
        self.rows = rows
        self.mean, self.inertial, self.scale = inertial_scale(rows.columns.robot, held)
        self.torque_rms = np.sqrt((rows.tau**2).sum(1) / np.maximum(rows.measured.sum(1), 1))
        self.speed_rms = np.sqrt(np.mean(rows.qd**2, axis=1))
        self.moving = moving(rows.qd, rows.block, rows.columns.slow.numpy())
        self._drift, self._drift_order = drift_basis(rows.t, rows.recording, DRIFT_HZ, MOST_DRIFT)
        self._local = len(ORDINARY) + 4 + len(STICKS) + _ROUNDING + len(self._drift)
        self._inside = [rows.recording == k for k in np.unique(rows.recording)]
        # Bodies that a joint does not move have no columns there.
        self._moved = [np.flatnonzero(np.isin(self.inertial, own)) for own in rows.columns.inertial]
        self._rigid = [self._rigid_columns(j, Y) for j, Y in enumerate(rows.rigid)]
        self.target = self._target_given(self.mean)
        mass = rows.columns.robot.mass_matrix(torch.from_numpy(rows.q.T)).numpy()
        self._carried = np.einsum("mjk,k->jm", mass**2, rows.encoder_std**2)
        self._undirected = {k: rows.evaluated(partial(self._direction_std, k)) for k in STICKS}
        self._resting = [self._rests(j) for j in range(rows.n_dof)]
        rest = np.any(self._undirected[_REST_STICK] > _RESTS, axis=0)
        self._breaking = maximum_filter1d(rest.astype(float), 2 * _FELT_ROWS + 1)
        ends = len(self.inertial) + rows.n_dof * (self._local + _FASTEST) + 2 * len(self._inside)
        self._around = [_near(rest) for rest in self._resting]
        self._holding = [self._holds(rest) for rest in self._resting]
        both = zip(self._holding, self._around, strict=True)
        self._rest_at = ends + np.cumsum([0, *(len(holds) + len(turns) for holds, turns in both)])
        self.n = int(self._rest_at[-1])
        self.index = [predicted(rows.run, measured) for measured in rows.measured]
        self._directions: dict[tuple[int, float], np.ndarray] = {}

    def _rigid_columns(self, joint: int, Y: np.ndarray) -> np.ndarray:
        """Return the columns (p, M) of the bodies that a joint moves, for a kappa of one; Y (M, p_j) as ``rigid``."""
        moved = self._moved[joint]
        fitted = np.isin(self.rows.columns.inertial[joint], self.inertial)
        return (Y[:, fitted] @ self.scale[np.ix_(moved, moved)]).T

    def _target_given(self, pi: np.ndarray) -> np.ndarray:
        """Return the torques minus those of a rigid body with pi (n_params,), (n, M)."""
        return self.rows.tau - self.rows.load(pi)

    def felt_through(self, C: Sequence[np.ndarray], pi: np.ndarray) -> Machine:
        """Return the same machine with bodies that also act through an effect: tau = Y pi' + C (pi' - pi) + that of pi.

        Args:
            C: per joint, as ``Rows.rigid``.
            pi: (n_params,) in the effect's own columns, which are additional to the machine's.
        """
        other = copy(self)
        both = zip(self.rows.rigid, C, strict=True)
        other._rigid = [self._rigid_columns(j, Y + more) for j, (Y, more) in enumerate(both)]
        own = zip(C, self.rows.columns.inertial, strict=True)
        other.target = self._target_given(self.mean) + np.stack([more @ (pi - self.mean)[at] for more, at in own])
        return other

    def _direction_std(self, stick: float, signals: Signals) -> Tensor:
        """Return the standard deviation of sign(qd), (n, N): 2 sqrt(p (1 - p)), p the probability that it is wrong."""
        speed_std = torch.from_numpy(np.maximum(stick * self.rows.speed_std, 1e-300))
        p = torch.special.ndtr(-signals.qd.abs() / speed_std.unsqueeze(1))
        return 2.0 * (p * (1.0 - p)).sqrt()

    def _rests(self, joint: int) -> np.ndarray:
        """Return the uncertainty of the direction of a joint's motion (E, M), rest by rest."""
        u = self._undirected[_REST_STICK][joint]
        still = u > _RESTS
        begins = still & ~np.concatenate(([False], still[:-1] & (np.diff(self.rows.run) == 0)))
        number = np.where(still, np.cumsum(begins), 0)
        lengths = np.bincount(number, weights=u**2)[1:]
        kept = np.sort(np.argsort(-lengths)[:_MOST_RESTS]) + 1
        return np.array([np.where(number == k, u, 0.0) for k in kept]).reshape(len(kept), len(u))

    def _holds(self, rests: np.ndarray) -> np.ndarray:
        """Return the functions of time for friction during rests (E, M), the slowest ones first, (H, M).

        During a rest friction is a random walk: its cosines are smaller the faster they are.
        """
        found: list[tuple[int, int, np.ndarray]] = []
        for rest in rests:
            at = np.flatnonzero(rest)
            passed = np.linspace(0.0, math.pi, len(at))
            for order in range(1 + int(2.0 * _HOLDS_HZ * len(at) * self.rows.dt_out)):
                way = np.zeros(len(rest))
                way[at] = rest[at] * np.cos(order * passed) / (1 + order)
                found.append((order, -len(at), way))
        kept = sorted(found, key=lambda one: one[:2])[:_MOST_HOLDS]
        return np.array([way for *_, way in kept]).reshape(len(kept), rests.shape[1])

    def ordinary(self, joint: int) -> np.ndarray:
        """Return the indices of a joint's viscous and both Coulomb frictions, (3,)."""
        return self._first(joint) + np.arange(len(ORDINARY))

    def bend(self, joint: int) -> int:
        """Return the index of the width of a joint's sign change."""
        return self._first(joint) + len(ORDINARY)

    def sticks(self, joint: int) -> np.ndarray:
        """Return the indices of the friction that holds a joint at rest, (3,)."""
        return self.bend(joint) + 1 + np.arange(len(STICKS))

    @property
    def resisting(self) -> np.ndarray:
        """Indices of all baseline friction, (3 n_dof,)."""
        return np.concatenate([self.ordinary(j) for j in range(self.rows.n_dof)])

    def drifting(self, joint: int) -> np.ndarray:
        """Return the indices of a joint's drift."""
        return self._first(joint) + np.arange(self._local - len(self._drift), self._local)

    def wandering(self, joint: int) -> np.ndarray:
        """Return the indices of a joint's drift without its levels, which may be an offset."""
        return self.drifting(joint)[self._drift_order > 0]

    def holding(self, joint: int) -> np.ndarray:
        """Return the indices of the friction at each of a joint's rests."""
        return self._rest_at[joint] + np.arange(len(self._holding[joint]))

    def resting(self, joint: int) -> np.ndarray:
        """Return the indices of a joint's rests: the friction at each, then the time of its change."""
        return np.arange(self._rest_at[joint], self._rest_at[joint + 1])

    @property
    def local(self) -> list[np.ndarray]:
        """Indices of the coefficients that only one joint has, joint by joint."""
        each = range(self.rows.n_dof)
        return [np.concatenate((self._first(j) + np.arange(self._local), self.resting(j))) for j in each]

    def spread(self, joint: int, encoder_share: float, loose: float = 0.0, stick: float = 1.0) -> np.ndarray:
        """Return the relative noise of a joint's rows, (M,): s^2 = 1 - k + k m^2 / mean m^2 + l^2 u^2

        Encoder noise is differentiated twice and multiplied by the row of the mass matrix, m^2 = sum_k M_jk^2 s_k^2.
        Friction is uncertain where the velocity does not show its direction; u is the standard deviation of that
        direction.

        Args:
            joint: its index.
            encoder_share: k, mean share of the noise that comes from encoders.
            loose: l, Coulomb friction in units of the noise.
            stick: multiple of the velocity's error below which a joint may be at rest, see ``STICKS``.
        """
        m = self._carried[joint]
        # Encoders add no noise at a joint whose links have no mass: its rows are equally noisy.
        encoders = 1.0 - encoder_share + encoder_share * (m / m.mean() if m.any() else np.ones_like(m))
        return np.sqrt(encoders + (loose * self._undirected[stick][joint]) ** 2)

    @property
    def timing(self) -> np.ndarray:
        """Indices of the clocks' offsets, one per recording."""
        return self._rest_at[0] - 2 * len(self._inside) + np.arange(len(self._inside))

    @property
    def timing_std(self) -> float:
        """Prior standard deviation of the clocks' offset [s]."""
        return _TIMING_SAMPLES * self.rows.dt

    def _first(self, joint: int) -> int:
        return len(self.inertial) + joint * self._local

    def sign(self, joint: int, width: float) -> np.ndarray:
        """Return max(g, 0) and min(g, 0), (2, M), of g = tanh(qd / width)."""
        return self._evaluated_directions(joint, width)[:2]

    def held(self, joint: int, width: float) -> np.ndarray:
        """Return g' - g, (3, M): g' is g = tanh(qd / width), with straight lines wherever the joint may rest.

        The three columns differ in the speed below which it may rest, see ``STICKS``.
        """
        return self._evaluated_directions(joint, width)[2:]

    def _evaluated_directions(self, joint: int, width: float) -> np.ndarray:
        def directions(signals: Signals) -> Tensor:
            qd = signals.qd[joint] * float(self.moving[joint])
            g = torch.tanh(qd / width)
            # Where the direction is this uncertain, as in ``_direction_std``.
            unsure = (qd.abs() < _SLOW * stick * max(self.rows.speed_std[joint], 1e-300) for stick in STICKS)
            lines = [_straight(g.numpy(), rests.numpy()) - g.numpy() for rests in unsure]
            return torch.stack((g.clamp_min(0.0), g.clamp_max(0.0), *map(torch.from_numpy, lines)))

        found = self._directions.pop((joint, width), None)
        if found is None:
            found = self.rows.evaluated(directions)
            if len(self._directions) >= _MOST_DIRECTIONS:
                del self._directions[next(iter(self._directions))]
        self._directions[joint, width] = found
        return found

    def friction_columns(self, joint: int, width: float) -> np.ndarray:
        """Return the features of baseline friction, (3, M)."""
        return np.concatenate((self.rows.qd[[joint]] * self.moving[joint], self.sign(joint, width)))

    def friction_std(self, joint: int, features: np.ndarray) -> np.ndarray:
        """Return the prior standard deviations of their coefficients, (K,): all of the joint's torque."""
        size = np.sqrt(np.mean(features**2, axis=1))
        return np.where(size > 0, self.torque_rms[joint] / np.maximum(size, 1e-300), 0.0)

    @property
    def averaging(self) -> np.ndarray:
        """Indices of the corrections of the joints' fastest motion, (2 n_dof,): a of each joint, then b."""
        return self._first(self.rows.n_dof) + np.arange(_FASTEST * self.rows.n_dof)

    @property
    def _averaging_std(self) -> np.ndarray:
        """Prior standard deviations of the same, (2 n_dof,): 1 / W - 1, with W at the band's edge, see ``_fastest``."""
        noise = np.tile(self.rows.noise_share, _FASTEST)
        return noise / np.maximum(1.0 - noise, _LEAST_GAIN)

    def _fastest(self, signals: Signals) -> Iterator[Tensor]:
        """Yield d^2q/dt^2 and d^4q/dt^4 (n, N) of the joints' fast motion, with the band's edge as unit [rad or m]."""
        t, edge_hz = signals.sequence(), 1.0 / (_EDGE_ROWS * self.rows.dt_out)
        x = signals.q - flat_below(signals.q, float(t[1] - t[0]), _FAST * edge_hz)
        for _ in range(_FASTEST):
            x = signals.rate(signals.rate(x)) / (2.0 * math.pi * edge_hz) ** 2
            yield x

    def slopes(self, hyper: Hyper) -> np.ndarray:
        """Return the columns (2 + 2 n + 2 + 2, n, M) that depend on the load.

        They are d(tau_s)/dt of all supplied torque, and the high-frequency part of the load's; each joint's fastest
        motion, d^2q/dt^2 of each, then d^4q/dt^4 of each; d/dt and d^2/dt^2 of the direction of Coulomb friction; and
        rounding.
        """
        step = torch.from_numpy(np.nan_to_num(self.rows.torque_step, nan=np.inf)).unsqueeze(1)

        def derivatives(signals: Signals) -> Tensor:
            # Use a copy, so that its large cached values are freed with the tile.
            signals = replace(signals)
            turns = 2.0 * math.pi * signals.supplied / step
            amplitude = torch.where(step.isinf(), 0.0, step / math.pi)
            fastest = [signals.deviating(k, x[k]) for x in self._fastest(signals) for k in range(self.rows.n_dof)]
            turns_at = signals.rate(signals.directions)
            rounding = amplitude * turns.sin(), amplitude * turns.cos()
            t, rate = signals.sequence(), signals.rate(signals.supplied)
            of_load = signals.rate(signals.load)
            fast = of_load - below(of_load, float(t[1] - t[0]), OFFSET_HZ)
            return torch.stack((rate, fast, *fastest, turns_at, signals.rate(turns_at), *rounding))

        return self.rows.around(hyper.pi, hyper.friction, hyper.rest_width).evaluated(derivatives)

    def design(self, joint: int, hyper: Hyper, slopes: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns (P_j, M) of a joint, without their ``sizes``, and their coefficients (P_j,).

        Args:
            joint: its index.
            hyper: the present values.
            slopes: from ``slopes``; without them time and response are exact.
        """
        first, width = self._first(joint), float(hyper.rest_width[joint])
        friction = self.friction_columns(joint, width)
        bend = self.sign(joint, width * _WIDTH_STEP).sum(0) - self.sign(joint, width / _WIDTH_STEP).sum(0)
        coulomb = float(hyper.friction[joint, 1])
        bend *= (not hyper.white) * _WIDTH_STD * coulomb / (2 * math.log(_WIDTH_STEP))
        parts = [
            self._rigid[joint],
            friction * self.friction_std(joint, friction)[:, None],
            bend[None],
            coulomb * self.held(joint, width),
            self._drift,
        ]
        local = first + np.arange(len(ORDINARY) + 1 + len(STICKS))
        places = [self._moved[joint], local, self.drifting(joint)]
        if slopes is not None:
            lasting = 0.5 * (_LASTING_ROWS * self.rows.dt_out) ** 2
            late, long = slopes[-_ROUNDING - 2 : -_ROUNDING, joint]
            fast = self.timing_std * self.rows.noise_share[joint] * slopes[1, joint]
            own = coulomb * lasting * long, self._breaking * fast, *slopes[-_ROUNDING:, joint]
            parts.append(np.stack((coulomb * self.rows.dt * late, *own)))
            places.append(local[-1] + 1 + np.arange(3 + _ROUNDING))
            fastest = slopes[2 : -_ROUNDING - 2, joint]
            felt = np.flatnonzero(fastest.any(axis=1))
            parts.append(fastest[felt] * self._averaging_std[felt, None])
            places.append(self.averaging[felt])
            inside = np.array(self._inside)
            parts += [self.timing_std * slopes[0, joint] * inside, fast * inside]
            places += [self.timing, self.timing + len(inside)]
            parts.append(self._holding[joint])
            parts.append(_TURNS_SAMPLES * self.rows.dt * late * self._around[joint])
            places.append(self.resting(joint))
        return np.concatenate(parts), np.concatenate(places)

    def sizes(self, joint: int, own: np.ndarray, hyper: Hyper) -> np.ndarray:
        """Return the factors (P_j,) of a joint's columns that give prior coordinates.

        They are learnt more often than the columns themselves: those of bodies (the URDF's error), of drift, and of the
        friction at rest.
        """
        first, size = int(self.drifting(joint)[0]), np.ones(len(own))
        size[own < len(self.inertial)] = 1.0 / math.sqrt(hyper.kappa)
        drift = (own >= first) & (own < first + len(self._drift))
        size[drift] = hyper.drift[joint] / np.maximum(self._drift_order[own[drift] - first], 1)
        size[np.isin(own, self.resting(joint))] = hyper.held[joint]
        return size

    def pi(self, z: np.ndarray, kappa: float) -> Tensor:
        """Return the inertial parameters (n_params,) of coefficients z."""
        pi = self.mean.copy()
        pi[self.inertial] += self.scale @ z[: len(self.inertial)] / math.sqrt(kappa)
        return torch.from_numpy(pi)

    def friction(self, z: np.ndarray, hyper: Hyper) -> np.ndarray:
        """Return viscous and both Coulomb coefficients of each joint, (n, 3)."""
        found = np.zeros((self.rows.n_dof, len(ORDINARY)))
        for joint in range(self.rows.n_dof):
            found[joint] = z[self.ordinary(joint)] * self.friction_size(joint, hyper)
        return found

    def friction_size(self, joint: int, hyper: Hyper) -> np.ndarray:
        """Return baseline friction (3,) of a joint for coefficients of one."""
        return self.friction_std(joint, self.friction_columns(joint, float(hyper.rest_width[joint])))


def _near(rests: np.ndarray) -> np.ndarray:
    """Return which rows belong to each of E rests (E, M), including neighbouring rows, each row to one at most."""
    weight = np.array([maximum_filter1d(rest, 2 * _FELT_ROWS + 1) + rest for rest in rests]).reshape(rests.shape)
    return (weight > 0) & (np.arange(len(rests))[:, None] == weight.argmax(0)) if len(rests) else weight


def _straight(g: np.ndarray, rests: np.ndarray) -> np.ndarray:
    """Return a signal (N,) with straight lines where it is at rest (N,) bool."""
    at = np.arange(len(g))
    return np.interp(at, at[~rests], g[~rests]) if not rests.all() else g
