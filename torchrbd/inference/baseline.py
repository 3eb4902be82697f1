"""The baseline: least squares on base parameters with viscous friction, Coulomb friction and an offset at each joint.

    min_x sum_j 1 / s_j^2 sum_rows (tau_j - Y_j pi - d_j qd_j - c_j sign(qd_j) - o_j)^2

Other models are compared with it: it is what an engineer fits first. All rows count alike, states are filtered, and
torques are taken at the time at which they were recorded. Only known loads are subtracted. The weights 1 / s_j^2 are
the inverse residual variances of the joints. Its inertial parameters need not be physical.

Source: Gautier, "Dynamic identification of robots with power model", ICRA 1997; Swevers, Verdonck, De Schutter,
    "Dynamic model identification for industrial robots", IEEE Control Systems 2007.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from torchrbd.dataset.columns import Columns
from torchrbd.dataset.scales import covered_scales
from torchrbd.effects import Term, effect
from torchrbd.effects.registry import PLAIN
from torchrbd.inference.estimators.problem import linear_problem
from torchrbd.inference.physical.fitting import term_candidates
from torchrbd.inference.preparation import Prepared
from torchrbd.likelihood.urdf_prior import data_prior
from torchrbd.model import RigidBodyDynamics, known_terms


def fit_baseline(prepared: Prepared) -> RigidBodyDynamics:
    """Fit the baseline to the blocks that are not held out; reads the recordings again.

    Args:
        prepared: the data. Clock delays, sticking and smoothed states in it are ignored.
    """
    reading = replace(prepared.reading, smoothed=(), delay_s={}, lag_s={})
    columns = Columns(prepared.robot, map(effect, PLAIN), covered_scales(reading.surveys, reading.filtering))
    statistics, robot = reading.statistics(columns, lambda *_: None), prepared.robot
    held = frozenset(name for k, name in enumerate(robot.body_names) if k not in prepared.prior.bodies)
    prior = data_prior(statistics.together(~prepared.held_out), held, prepared.prior.kappa)
    alike = replace(prepared, reading=reading, columns=columns, statistics=statistics, prior=prior, states=None)
    terms = term_candidates(columns, PLAIN)
    x = linear_problem(alike, terms).weighted()[0]
    width = torch.tensor([scale.rest_width for scale in columns.scales], dtype=torch.float64)
    fitted = [Term(c.effect, c.site, x[columns.of(c)], c.shape) for c in terms]
    pi = x[: robot.n_params]
    return RigidBodyDynamics(robot, pi, [*known_terms(robot), *fitted], width, reading.conditions)
