"""A robot as the kernels read it: tables of integers and numbers, the fields of `Node` and `Constants` in motion.h."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchrbd.robot.kinematics import Geometry


class Tables(NamedTuple):
    """A robot's constants, on the CPU.

    Attributes:
        structure: (2 + 4 n_bodies,) int64: n_bodies, n_dof; of each body parent, end of its subtree, driver, whether it
            slides.
        constants: (35 n_bodies,) float64: of each body A, B, C (27), translation (3), axis (3), multiplier, offset.
    """

    structure: Tensor
    constants: Tensor


NO_ROBOT = Tables(torch.empty(0, dtype=torch.int64), torch.empty(0, dtype=torch.float64))
"""For kernels that do not depend on a robot."""


def build_tables(geometry: Geometry) -> Tables:
    """Return the tables of a robot whose geometry is in float64 on the CPU."""
    n_bodies, n_dof = geometry.coupling.shape
    nodes = torch.tensor([geometry.parents, geometry.ends, geometry.drivers, geometry.prismatic], dtype=torch.int64)
    rotation = geometry.rotation[..., 0].permute(2, 0, 1, 3).flatten(1)
    multiplier = geometry.coupling[range(n_bodies), geometry.drivers]
    columns = (rotation, geometry.translation[..., 0].T, geometry.axis[..., 0].T, multiplier[:, None], geometry.offset)
    structure = torch.cat((torch.tensor([n_bodies, n_dof]), nodes.T.flatten()))
    return Tables(structure, torch.cat(columns, 1).flatten())


def geometry_of(tables: Tables) -> Geometry:
    """Return the geometry that tables were built from."""
    n_bodies, n_dof = tables.structure[:2].tolist()
    parents, ends, drivers, slides = map(tuple, tables.structure[2:].unflatten(0, (-1, 4)).T.tolist())
    rotation, translation, axis, multiplier, offset = tables.constants.unflatten(0, (-1, 35)).split((27, 3, 3, 1, 1), 1)
    above = torch.zeros(n_bodies, n_bodies, dtype=axis.dtype)
    for body, end in enumerate(ends):
        above[body:end, body] = 1
    coupling = torch.zeros(n_bodies, n_dof, dtype=axis.dtype)
    coupling[range(n_bodies), drivers] = multiplier[:, 0]
    prismatic = torch.tensor(slides, dtype=axis.dtype)[:, None]
    return Geometry(
        parents=parents,
        ends=ends,
        drivers=drivers,
        prismatic=tuple(map(bool, slides)),
        rotation=rotation.unflatten(1, (3, 3, 3)).permute(1, 2, 0, 3)[..., None].contiguous(),
        translation=translation.T[..., None].contiguous(),
        axis=axis.T[..., None].contiguous(),
        turns=1 - prismatic,
        slides=prismatic,
        above=above,
        coupling=coupling,
        offset=offset.contiguous(),
    )
