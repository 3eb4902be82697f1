"""The oracle: the model that is told which effects there are, where, and with which shapes, and fits the rest.

Its error on held-out recordings is what a perfect diagnosis would reach with this library of effects.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from torchrbd.effects import Effect, JointScale, Shape, Site, Window, known_effects
from torchrbd.inference.physical.fitting import judge
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.robot import RobotModel

Json = Mapping[str, Any]


def told(effect: Effect, number: int, sites: tuple[Site, ...], shape: Shape) -> Effect:
    """Return an effect that can only be where and as it is told; the number keeps effects of one kind apart."""

    class Told(type(effect)):
        id = f"{effect.id}_{number}"

        def sites(self, robot: RobotModel, windows: Sequence[Window] = ()) -> tuple[Site, ...]:
            return sites

        def shapes(self, scale: JointScale) -> tuple[Shape, ...]:
            return (shape,)

    one = copy.copy(effect)
    one.__class__ = Told
    return one


def true_sites(effect: Effect, true: Json, robot: RobotModel) -> tuple[Site, ...]:
    """Return the sites of an effect that agree with a concealed one; none if the library has no such site."""
    where = true["where"]
    recordings, times = where.get("recordings"), where.get("time_s") or [()]
    windows = [Window(name, *span) for name in recordings or () for span in times]
    joints = [robot.joint_names.index(j) for j in true["joints"]]
    bodies = {b for b, links in robot.folded.items() if {link.name for link in links} & set(true["links"])}
    other = robot.joint_names.index(true["other"]) if true.get("other") else None

    def agrees(site: Site) -> bool:
        body = None if site.body is None else robot.body_names[site.body]
        return (
            (site.joint in joints if site.joint is not None else len(joints) in (0, robot.n_dof))
            and (body is None or body in bodies)
            and (other is None or site.other == other)
        )

    found = tuple(site for site in effect.sites(robot, windows) if agrees(site))
    whole = tuple(site for site in found if site.joint is None)
    return whole if whole and len(joints) == robot.n_dof else found


def true_shape(effect: Effect, known: Mapping[str, float]) -> Shape | None:
    """Return the shape that true parameters mean; None if they do not tell it."""
    if "delay" in known:
        known = {**known, "step": known["delay"]}
    _, shape = effect.coefficients({name: known.get(name, 0.0) for name in effect.units})
    return shape if shape.keys() <= known.keys() else None


def requested_effects(truth: Json, robot: RobotModel) -> list[Effect]:
    """Return what the library has of a case's effects, told where and how they are."""
    known, found = known_effects(), []
    for number, true in enumerate((*truth["effects"], *truth["background"])):
        if true["effect"] not in known:
            continue
        effect = known[true["effect"]]
        sites = true_sites(effect, true, robot)
        shape = true_shape(effect, true["parameters"])
        if sites and shape is not None:
            found.append(told(effect, number, sites, shape))
    return found


def offered(robot: RobotModel, found: Json) -> set[str]:
    """Return a concealed effect, or a finding, as ``diagnose`` is told it: with its places if it acts at all times."""
    known = known_effects()[found["effect"]]
    places = {site.name(robot) for site in true_sites(known, found, robot) if site.always}
    return {f"{known.id}@{place}" for place in places} or {known.id}


def oracle_errors(urdf: Path, fit: Iterable[Path], holdout: Iterable[Path], truth: Json) -> dict[str, float] | None:
    """Return the held-out nmse per joint of the oracle; None if the library lacks one of the concealed effects."""
    robot = RobotModel.from_urdf(urdf)
    told_all = requested_effects(truth, robot)
    if len(told_all) < len(truth["effects"]) + len(truth["background"]):
        return None
    settings = Settings.from_mapping({"holdout": list(holdout)}, "oracle")
    prepared = prepare(robot, list(fit), settings, told_all)
    model = prepared.fit(prepared.columns.candidates)
    return judge(prepared.judging, model.x).nmse
