"""Bodies as MuJoCo takes them: it refuses moving bodies without mass, and inertias that no body can have."""

from __future__ import annotations

import torch
from torch import Tensor

from torchrbd.display import Remark
from torchrbd.errors import PhysicalError
from torchrbd.export.xml_text import text
from torchrbd.robot import inertia_matrix

# Above what MuJoCo takes for zero (1e-15), and far below what shows in any torque [kg, kg m^2].
LEAST = 1e-12
# In parts of the largest moment: what rounding does, and what is none of it.
_ROUNDING, _WRONG = 1e-12, 1e-9


def inertial(pi: Tensor, link: str) -> tuple[dict[str, str], list[Remark]]:
    """Return the attributes of <inertial> for parameters pi (10,) about a link's origin, and what differs from these.

    Raises:
        PhysicalError: no rigid body has these parameters.
    """
    mass = float(pi[0])
    if mass == 0 and not pi.any():
        remark = Remark("massless link", {"link": link, "least": LEAST})
        return _attributes(LEAST, pi[1:4], LEAST * torch.eye(3, dtype=pi.dtype)), [remark]
    if not mass > 0:
        raise PhysicalError(f"{link}: a mass of {mass:.4g} kg is none that MuJoCo takes; {_REMEDY}")
    c = pi[1:4] / mass
    central = inertia_matrix(pi) - mass * ((c @ c) * torch.eye(3, dtype=pi.dtype) - torch.outer(c, c))
    low, middle, high = torch.linalg.eigvalsh(central).tolist()
    short = high - low - middle
    if min(-low, short) > 0 or max(-low, short) > _WRONG * max(high, float(torch.trace(inertia_matrix(pi)))):
        moments = ", ".join(f"{moment:.4g}" for moment in (low, middle, high))
        raise PhysicalError(f"{link}: principal moments {moments} kg m^2 are those of no rigid body; {_REMEDY}")
    # Of a point or a thin rod: as little as makes it a body.
    lift = max(0.0, LEAST - low, short + _ROUNDING * high if short > -_ROUNDING * high else 0.0)
    remarks = [Remark("link without width", {"link": link, "lift": lift})] if lift else []
    return _attributes(mass, c, central + lift * torch.eye(3, dtype=pi.dtype)), remarks


_REMEDY = "correct <inertial> in the URDF, or re-fit the link (identify or diagnose without --trust)"


def _attributes(mass: float, c: Tensor, central: Tensor) -> dict[str, str]:
    entries = central[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return {"mass": text(mass), "pos": text(c.tolist()), "fullinertia": text(entries.tolist())}
