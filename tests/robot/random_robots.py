"""Random robots as URDF text. Needs nothing but numpy, so that it is independent of what it tests."""

from __future__ import annotations

import numpy as np

KINDS = ("revolute", "continuous", "prismatic")


def random_urdf(
    seed: int,
    n_joints: int = 6,
    *,
    kinds: tuple[str, ...] = KINDS,
    branching: float = 0.3,
    fixed: float = 0.2,
    massless: float = 0.1,
    mimic: float = 0.0,
) -> str:
    """Write a random tree: rotated joint and inertial origins, any axis, physical inertias, links in any order.

    Args:
        seed: of the random numbers.
        n_joints: number of moving joints.
        kinds: joint types to choose from.
        branching: probability that a joint hangs on a random earlier link and not on the last one.
        fixed: probability that another link is fixed to a moving one.
        massless: probability that a link has no inertial (never a leaf, so that the mass matrix stays regular).
        mimic: probability that a joint follows an earlier one.
    """
    rng = np.random.default_rng(seed)
    tags: list[str] = []
    carriers = ["base"]
    parents: list[str] = []
    free: list[str] = []
    for i in range(1, n_joints + 1):
        parent = carriers[-1] if rng.random() > branching else str(rng.choice(carriers))
        kind = str(rng.choice(kinds))
        follows = str(rng.choice(free)) if free and rng.random() < mimic else None
        if follows is None:
            free.append(f"joint{i}")
        tags.append(_joint(rng, f"joint{i}", kind, parent, f"link{i}", follows))
        parents.append(parent)
        carriers.append(f"link{i}")
        if rng.random() < fixed:
            tags.append(_joint(rng, f"mount{i}", "fixed", f"link{i}", f"tool{i}"))
            carriers.append(f"tool{i}")
            parents.append(f"link{i}")
    inner = set(parents)
    links = [
        f'<link name="{c}">{_inertial(rng) if c not in inner or rng.random() > massless else ""}</link>'
        for c in carriers
    ]
    parts = [*links, *tags]
    order = rng.permutation(len(parts))
    body = "\n  ".join(parts[i] for i in order)
    return f'<?xml version="1.0" encoding="utf-8"?>\n<robot name="random{seed}">\n  {body}\n</robot>\n'


def random_states(seed: int, *shape: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return random positions, velocities and accelerations of one shape."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-2.5, 2.5, shape), rng.normal(size=shape), 3 * rng.normal(size=shape)


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(v)) for v in np.atleast_1d(values))


def _origin(rng: np.random.Generator, reach: float) -> str:
    return f'<origin xyz="{_text(rng.uniform(-reach, reach, 3))}" rpy="{_text(rng.uniform(-3, 3, 3))}"/>'


def _joint(rng: np.random.Generator, name: str, kind: str, parent: str, child: str, follows: str | None = None) -> str:
    axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.3 else rng.normal(size=3)
    limit = '<limit lower="-3" upper="3" velocity="5" effort="100"/>' if kind != "continuous" else ""
    axis_tag = f'<axis xyz="{_text(axis / np.linalg.norm(axis))}"/>' if kind != "fixed" else ""
    coupling = f'<mimic joint="{follows}" multiplier="{rng.normal()!r}" offset="{rng.normal()!r}"/>' if follows else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{_origin(rng, 0.5)}{axis_tag}{limit}{coupling}</joint>"
    )


def _inertial(rng: np.random.Generator) -> str:
    mass = rng.uniform(0.2, 5)
    second = np.diag(rng.uniform(0.01, 0.05, 3)) * mass
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    inertia = turn @ (np.trace(second) * np.eye(3) - second) @ turn.T
    entries = {n: inertia["xyz".index(n[0]), "xyz".index(n[1])] for n in ("xx", "xy", "xz", "yy", "yz", "zz")}
    numbers = " ".join(f'i{name}="{float(value)!r}"' for name, value in entries.items())
    return f'<inertial>{_origin(rng, 0.2)}<mass value="{mass!r}"/><inertia {numbers}/></inertial>'
