"""The baseline model: a sum of components, rigid body and what every machine has, on one set of rows.

    tau_j = sum over components, sum_k z_k size_jk column_jk,   z ~ N(0, 1)

Each component is one file of ``torchrbd/nuisance``, with its equation.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.rows import Rows
from torchrbd.effects import Signals
from torchrbd.likelihood.coefficient_prior import inertial_scale
from torchrbd.likelihood.hyper import Hyper
from torchrbd.likelihood.noise import predicted
from torchrbd.nuisance.breakaway import Breakaway
from torchrbd.nuisance.clock_offset import ClockOffset
from torchrbd.nuisance.component import Along, Component
from torchrbd.nuisance.directions import Directions
from torchrbd.nuisance.drift import Drift
from torchrbd.nuisance.friction_transition import FrictionTransition
from torchrbd.nuisance.joint_friction import JointFriction
from torchrbd.nuisance.rest_holding import RestHolding
from torchrbd.nuisance.rests import Rests
from torchrbd.nuisance.rigid_body import RigidBody
from torchrbd.nuisance.rotor import Rotor
from torchrbd.nuisance.row_noise import RowNoise
from torchrbd.nuisance.state_bandwidth import StateBandwidth
from torchrbd.nuisance.sticking import Sticking
from torchrbd.nuisance.torque_quantisation import TorqueQuantisation


class Machine:
    """Components on one set of rows.

    Args:
        rows: the data.
        held: bodies whose inertia is not fitted.

    Attributes:
        n: number of coefficients.
        torque_rms: (n_dof,) of the measured torque [N m or N].
        index: per joint, the rows (m,) that are whitened.
        target: (n_dof, M) torques minus those of the URDF's rigid body.
        directions: of the motion.
        noise: of the rows, relative to each other.
    """

    def __init__(self, rows: Rows, held: frozenset[str] = frozenset()) -> None:
        self.rows = rows
        self.torque_rms = np.sqrt((rows.tau**2).sum(1) / np.maximum(rows.measured.sum(1), 1))
        self.index = [predicted(rows.run, measured) for measured in rows.measured]
        self.directions = Directions(rows)
        self.noise, rests = RowNoise(rows, self.directions), Rests(rows, self.directions)
        self.bodies = RigidBody(rows, *inertial_scale(rows.columns.robot, held))
        self.friction = JointFriction(rows, self.directions, self.torque_rms)
        self.transition, self.sticking = FrictionTransition(rows, self.directions), Sticking(self.directions)
        self.rotors = Rotor(rows, self.torque_rms)
        self.drift, self.clocks, self.rests = Drift(rows), ClockOffset(rows), RestHolding(rows, rests)
        self.target = self.bodies.target
        self._others = (Breakaway(rows, rests, self.clocks.std), TorqueQuantisation(rows), StateBandwidth(rows))
        self.n = 0
        for component in self.components:
            component.first = self.n
            self.n += component.n

    @property
    def components(self) -> tuple[Component, ...]:
        """All of them, in the order of their coefficients."""
        friction = self.friction, self.transition, self.sticking
        return self.bodies, *friction, self.rotors, *self._others, self.drift, self.clocks, self.rests

    def felt_through(self, C: Sequence[np.ndarray], pi: np.ndarray) -> Machine:
        """Return the same machine with bodies that also act through an effect, see ``RigidBody.felt_through``."""
        other = copy(self)
        other.bodies = self.bodies.felt_through(C, pi)
        other.target = other.bodies.target
        return other

    @property
    def positive(self) -> np.ndarray:
        """Indices of the coefficients that physics keeps non-negative: friction, and the rotors of drives."""
        return np.concatenate((self.friction.index, self.rotors.index))

    @property
    def local(self) -> list[np.ndarray]:
        """Indices of the coefficients that only one joint has, joint by joint."""
        own = [one for one in self.components if one.local]
        return [np.concatenate([one.at(j) for one in own]) for j in range(self.rows.n_dof)]

    def along(self, hyper: Hyper) -> Along:
        """Return the features of all components along the motion, with the load and friction of present values."""
        wanted = {name: f for one in self.components for name, f in one.along().items()}
        counts = list[int]()

        def stacked(signals: Signals) -> Tensor:
            # Use a copy, so that its large cached values are freed with the tile.
            signals = copy(signals)
            found = [f(signals) for f in wanted.values()]
            counts[:] = [1 if x.ndim == 2 else len(x) for x in found]
            return torch.cat([x.unsqueeze(0) if x.ndim == 2 else x for x in found])

        made = self.rows.around(hyper.pi, hyper.friction, hyper.rest_width).evaluated(stacked)
        parts = zip(wanted, np.split(made, np.cumsum(counts)[:-1]), strict=True)
        return {name: part[0] if len(part) == 1 else part for name, part in parts}

    def design(self, joint: int, hyper: Hyper, along: Along | None) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns (P_j, M) of a joint, without their ``sizes``, and their coefficients (P_j,).

        Args:
            joint: its index.
            hyper: the present values.
            along: see ``along``; without it time and response are exact.
        """
        columns, places = zip(*(one.columns(joint, hyper, along) for one in self.components), strict=True)
        return np.concatenate(columns), np.concatenate(places)

    def sizes(self, joint: int, own: np.ndarray, hyper: Hyper) -> np.ndarray:
        """Return the factors (P_j,) of a joint's columns that give prior coordinates."""
        size = np.ones(len(own))
        for one in self.components:
            inside = (own >= one.first) & (own < one.first + one.n)
            size[inside] = one.sizes(joint, own[inside], hyper)
        return size
