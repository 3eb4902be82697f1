"""The gallery of effects: a page for each registered effect, with pictures and what it is confused with.

All is computed from the registry on one standard motion of the bundled arm, so that an effect that is added has its
page at once. The torque of an effect is that of its ``features`` at one place. Its residual is what least squares
leaves of it: base parameters of the rigid body, and viscous and Coulomb friction and an offset of each joint, fitted to
the effect's torque alone, each joint divided by the root mean square of its torque.
"""

from __future__ import annotations

import html
import inspect
import io
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

import torchrbd
from torchrbd.effects import Effect, JointScale, Shape, Signals, Site, Window, known_effects

ARM = Path(torchrbd.__file__).with_name("demo") / "arm.urdf"
JOINT = 2
"""The joint at which effects are shown, and that joints before and after it surround."""
_RATE_HZ, _DURATION_S, _REST_WIDTH = 100.0, 20.0, 0.02
_WINDOW = Window("standard", 6.0, 14.0)
_SIZE = 0.2  # of the root mean square of the joint's torque
_MOST_SHAPES = 12  # of a rival
_NOTHING = 1e-6  # of the mean square: rounding
_LEAST_SHOWN = 0.01  # of the largest mean square
_CLOSE = 0.9  # of the residual's mean square; who leaves more is no rival
_ROWS = 3  # of the table of what an effect is confused with
# Where the middle of the shapes to try makes a poor picture.
_EXAMPLES: dict[str, dict[str, float]] = {
    "actuator_lag": {"time_constant": 0.01, "bandwidth": 48.0},
    "backlash": {"backlash": 0.005, "flight": 0.005, "link_friction": 1.0},
    "encoder_offset": {"offset": 0.02},
    "external_wrench": dict.fromkeys(("force_x", "force_y", "moment_x", "moment_y", "moment_z"), 0.0)
    | {"force_z": -20.0},
    "joint_elasticity": {"stiffness": 4000.0, "bandwidth": 48.0, "compliance": 1 / 4000.0, "link_friction": 1.0},
    "one_sided_spring": {"contact_position": 0.6, "side": 1.0, "stiffness": 25.0},
    "payload": dict.fromkeys(("x", "y", "Ixy", "Ixz", "Iyz"), 0.0)
    | {"mass": 1.0, "z": 0.1, "Ixx": 0.012, "Iyy": 0.012, "Izz": 0.002},
    "time_delay": {"delay": 0.01, "step": 0.01, "bandwidth": 48.0},
    "torque_ripple": {"amplitude": 3.0, "phase": 0.0, "order": 12.0},
}
_SIGNALS = {"q": "position [rad]", "qd": "velocity [rad/s]", "qdd": "acceleration [rad/s²]", "t": "time [s]"} | {
    "load": "load [N m]",
    "temperature": "temperature [°C]",
    "q_other": "position of the other joint [rad]",
    "qd_other": "velocity of the other joint [rad/s]",
}
_INK, _PALE = "#3949ab", "#9e9e9e"


@dataclass(frozen=True)
class Example:
    """An effect at a place, with numbers.

    Attributes:
        torque: (n, N) that it adds [N m].
        residual: (n, N) what least squares leaves of it [N m].
        friction: whether friction was fitted too.
    """

    effect: Effect
    site: Site
    shape: Shape
    w: Tensor
    torque: Tensor
    residual: Tensor
    friction: bool


@dataclass(frozen=True)
class Rival:
    """Another effect, and the share of a residual's mean square that it leaves."""

    effect: Effect
    site: Site
    share: float


class Motion:
    """The standard motion, and least squares on it."""

    def __init__(self) -> None:
        self.robot = torchrbd.RobotModel.from_urdf(ARM)
        self.t = torch.arange(int(_DURATION_S * _RATE_HZ), dtype=torch.float64) / _RATE_HZ
        q, qd, qdd = _sines(self.robot.n_dof, self.t)
        width = torch.full((self.robot.n_dof,), _REST_WIDTH, dtype=torch.float64)
        warm = (20.0 + 30.0 * self.t / _DURATION_S).expand_as(q)
        known = {"t": self.t, "recording": _WINDOW.recording, "temperature": warm}
        self.signals = Signals(self.robot, q, qd, qdd, width, **known)
        self.rms = self.signals.load.square().mean(1).sqrt()

    @cached_property
    def scale(self) -> JointScale:
        q, qd = self.signals.q[JOINT], self.signals.qd[JOINT]
        load = float(self.signals.load[JOINT].abs().max())
        ends = float(q.min()), float(q.max())
        return JointScale(float(qd.abs().max()), _REST_WIDTH, *ends, load, _DURATION_S, (20.0, 50.0))

    @cached_property
    def bases(self) -> dict[bool, Tensor]:
        """Orthonormal columns (n N, K) of the rigid body, with friction and without."""
        rigid = self.signals.regressor.movedim(-2, 0)  # (n, N, P)
        n, samples = self.signals.q.shape
        own = torch.stack([self.signals.qd, self.signals.directions, torch.ones_like(self.signals.qd)], -1)
        friction = torch.zeros(n, samples, n, 3, dtype=torch.float64)
        friction[range(n), :, range(n)] = own
        both = torch.cat([rigid, friction.flatten(2)], -1)
        return {True: _orthonormal(self.columns(both)), False: _orthonormal(self.columns(rigid))}

    def columns(self, torques: Tensor) -> Tensor:
        """Return torques (n, N, K) as weighted columns (n N, K)."""
        return (torques / self.rms[:, None, None]).flatten(0, 1)

    def residual(self, torques: Tensor, friction: bool) -> Tensor:
        """Return what least squares leaves of torques (n, N, K), as weighted columns (n N, K)."""
        columns, basis = self.columns(torques), self.bases[friction]
        return columns - basis @ (basis.T @ columns)

    def span(self, effect: Effect, site: Site, shape: Shape, friction: bool) -> Tensor:
        """Return orthonormal columns (n N, K) of what least squares leaves of an effect."""
        torques = self.features(effect, site, shape)
        residual = self.residual(torques, friction)
        seen = residual.square().sum(0) > _NOTHING * self.columns(torques).square().sum(0)
        return _orthonormal(residual[:, seen])

    def features(self, effect: Effect, site: Site, shape: Shape) -> Tensor:
        """Return the columns of an effect as torques of all joints, (n, N, K)."""
        phi = torch.stack(list(effect.features_at(self.signals, site, shape).values()), -1)
        if effect.whole_robot:
            return phi.expand(*self.signals.q.shape, -1)
        found = torch.zeros(*self.signals.q.shape, phi.shape[-1], dtype=torch.float64)
        assert site.joint is not None
        found[site.joint] = phi
        return found


def _sines(n: int, t: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return positions, velocities and accelerations (n, N) of four sines a joint, no two of one frequency."""
    k = torch.arange(n, dtype=torch.float64)[:, None]
    q, qd, qdd = (torch.zeros(n, len(t), dtype=torch.float64) for _ in range(3))
    for line, (hz, size) in enumerate(((0.11, 0.7), (0.23, 0.35), (0.47, 0.15), (0.83, 0.06))):
        omega = 2 * torch.pi * hz * (1 + 0.06 * k)
        angle = omega * t + 2.4 * k + 1.1 * line
        q, qd, qdd = q + size * angle.sin(), qd + size * omega * angle.cos(), qdd - size * omega**2 * angle.sin()
    return q + 0.4 * (k % 2), qd, qdd


def example(motion: Motion, effect: Effect) -> Example:
    """Return an effect at a place near ``JOINT``, of a plausible size that the joint's torque shows."""
    site = _site(motion, effect)
    w, shape = _numbers(motion, effect, site)
    torque = motion.features(effect, site, shape) @ w
    # Every fit has plain friction, so that nothing of it would remain.
    friction = not effect.is_baseline
    left = motion.residual(torque[..., None], friction)
    residual = left.reshape(torque.shape) * motion.rms[:, None]
    return Example(effect, site, shape, w, torque, residual, friction)


def _site(motion: Motion, effect: Effect) -> Site:
    """Return a place at ``JOINT``; the last link, which carries loads and is pushed; or the first place there is."""
    sites = _all_sites(motion, effect)
    if sites[0].body is not None:
        return sites[-1]
    return next((site for site in sites if JOINT in (site.joint, site.other)), sites[0])


def _all_sites(motion: Motion, effect: Effect) -> Sequence[Site]:
    return effect.sites(motion.robot) or effect.sites(motion.robot, (_WINDOW,))


def _numbers(motion: Motion, effect: Effect, site: Site) -> tuple[Tensor, Shape]:
    """Return coefficients (K,) and a shape: plausible, and ``_SIZE`` of the torque if it can be."""
    if effect.id in _EXAMPLES:
        w, shape = effect.coefficients(_EXAMPLES[effect.id])
        return torch.tensor(w, dtype=torch.float64), shape
    for shape in _from_the_middle(effect.shapes(motion.scale)):
        columns = motion.features(effect, site, shape)
        for start in _starts(effect, motion.columns(columns)):
            share = float(((columns @ start) / motion.rms[:, None]).square().mean(1).max().sqrt())
            if not share > 0:
                continue
            for size in (_SIZE, _SIZE / 3, _SIZE / 10, _SIZE / 100):
                w = start * size / share
                agreed = effect.agreeing(w, shape)
                values = {name: float(value) for name, value in effect.parameters(w, agreed).items()}
                if effect.plausible(values, motion.scale):
                    return w, agreed
    raise ValueError(f"no plausible numbers for the effect '{effect.id}' on the standard motion")


def _from_the_middle(shapes: Sequence[Shape]) -> list[Shape]:
    middle = len(shapes) // 2
    return sorted(shapes, key=lambda shape: abs(shapes.index(shape) - middle))


def _starts(effect: Effect, columns: Tensor) -> Iterator[Tensor]:
    """Yield proportions of the coefficients (K,): as large a torque for each, then of other signs and sizes."""
    believed = effect.prior.proportions
    each = torch.tensor(believed, dtype=torch.float64) if believed else 1.0 / columns.norm(dim=0).clamp_min(1e-12)
    rng = np.random.default_rng(0)
    for trial in range(64):
        draws = np.ones(len(each)) if trial == 0 else rng.choice([1.0, 0.5, -0.5, -1.0], len(each))
        draws[list(effect.prior.positive)] = abs(draws[list(effect.prior.positive)])
        yield each * torch.from_numpy(draws)


def confusions(motion: Motion, examples: Sequence[Example], effects: Mapping[str, Effect]) -> list[list[Rival]]:
    """Return for each example other effects, each at its best place and shape; who leaves least comes first."""
    found: list[dict[str, Rival]] = [{} for _ in examples]
    for friction in sorted({one.friction for one in examples}):
        those = [k for k, one in enumerate(examples) if one.friction == friction]
        targets = torch.stack([motion.columns(examples[k].residual[..., None])[:, 0] for k in those], 1)
        targets = targets / targets.norm(dim=0)
        for effect in effects.values():
            for site, shape in product(_all_sites(motion, effect), _evenly(effect.shapes(motion.scale), _MOST_SHAPES)):
                left = 1.0 - (motion.span(effect, site, shape, friction).T @ targets).square().sum(0)
                for k, share in zip(those, left.clamp_min(0.0).tolist(), strict=True):
                    if effect.id not in found[k] or share < found[k][effect.id].share:
                        found[k][effect.id] = Rival(effect, site, share)
    return [
        sorted((rival for name, rival in of_one.items() if name != one.effect.id), key=lambda rival: rival.share)
        for one, of_one in zip(examples, found, strict=True)
    ]


def _orthonormal(columns: Tensor) -> Tensor:
    size = columns.norm(dim=0)
    columns = columns[:, size > 0] / size[size > 0]
    u, s, _ = torch.linalg.svd(columns, full_matrices=False)
    return u[:, s > 1e-9 * s[:1].sum()]


def _evenly(shapes: Sequence[Shape], most: int) -> list[Shape]:
    return [shapes[k] for k in sorted({round(x) for x in np.linspace(0, len(shapes) - 1, min(most, len(shapes)))})]


def picture(motion: Motion, one: Example) -> bytes:
    """Return the torque of an effect, and what least squares leaves of it on the standard motion, as SVG."""
    figure = Figure(figsize=(9.0, 2.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_torque(left, motion, one)
    joint = _shown_joint(motion, one)
    right.plot(motion.t, one.torque[joint], color=_PALE, lw=1, label="torque that it adds")
    right.plot(motion.t, one.residual[joint], color=_INK, lw=1.2, label="residual after the fit")
    right.set(xlabel="time [s]", title=f"Standard motion, {motion.robot.joint_names[joint]}")
    right.legend(frameon=False, fontsize=8, loc="upper right", ncols=2)
    low, high = right.get_ylim()
    right.set_ylim(low, high + 0.2 * (high - low))
    for axes in (left, right):
        axes.set_ylabel("torque [N m]")
        axes.title.set_size(9)
        axes.spines[["top", "right"]].set_visible(False)
    return _svg(figure)


def thumbnail(motion: Motion, one: Example) -> bytes:
    """Return the torque of an effect alone, without axes, as SVG."""
    figure = Figure(figsize=(1.4, 0.7))
    axes = figure.add_axes((0.02, 0.05, 0.96, 0.9))
    _draw_torque(axes, motion, one)
    axes.set(title="", xlabel="", ylabel="")
    axes.set_axis_off()
    return _svg(figure)


def _draw_torque(axes: Axes, motion: Motion, one: Example) -> None:
    """Draw the torque over the signal on which it depends, or over time where no one signal gives it."""
    axes.axhline(0.0, color=_PALE, lw=0.6)
    curve = one.effect.curve(one.w, one.shape, motion.scale)
    if curve is not None and not one.effect.has_memory:
        axes.plot(curve.x, curve.y.detach(), color=_INK, lw=1.5)
        axes.set(xlabel=_SIGNALS[curve.signal], title="Torque that it adds")
        return
    some = motion.t < _WINDOW.start_s if one.site.window is None else motion.t >= 0
    for joint in _moved_joints(motion, one):
        axes.plot(motion.t[some], one.torque[joint, some], lw=1.2, label=motion.robot.joint_names[joint])
    axes.set(xlabel="time [s]", title="Torque that it adds on the standard motion")
    axes.legend(frameon=False, fontsize=8)


def _moved_joints(motion: Motion, one: Example) -> list[int]:
    """Return the joints of which it takes the largest part of their torque, three at most."""
    share = one.torque.square().mean(1) / motion.rms.square()
    order = share.argsort(descending=True)[:3].tolist()
    return sorted(joint for joint in order if share[joint] > _LEAST_SHOWN * share.max())


def _shown_joint(motion: Motion, one: Example) -> int:
    return int((one.residual.square().mean(1) / motion.rms.square()).argmax())


def _svg(figure: Figure) -> bytes:
    file = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "torchrbd", "svg.fonttype": "none", "path.simplify_threshold": 0.5}):
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    return file.getvalue()


def pages(effects: Mapping[str, Effect] | None = None) -> dict[str, str | bytes]:
    """Return the files of the gallery by address: an index, and a page and two pictures for each effect."""
    effects = known_effects() if effects is None else effects
    motion = Motion()
    examples = {name: example(motion, effect) for name, effect in effects.items()}
    files: dict[str, str | bytes] = {"effects/index.md": _index(motion, examples)}
    for one, rivals in zip(examples.values(), confusions(motion, [*examples.values()], effects), strict=True):
        name = one.effect.id
        files[f"effects/{name}.md"] = _page(motion, one, rivals)
        files[f"effects/{name}.svg"] = picture(motion, one)
        files[f"effects/{name}_small.svg"] = thumbnail(motion, one)
    return files


def _index(motion: Motion, examples: Mapping[str, Example]) -> str:
    head = inspect.cleandoc(f"""
        # Effects

        What `torchrbd diagnose` looks for: {len(examples)} effects. Each adds a torque to that of the rigid body.
        The id is the name in `diagnosis.json` and for `--effects`. An effect of your own takes about 30 lines: see
        [the second notebook](../notebooks/2_your_own_effect.py).

        The column "residual" says how much of the effect's torque remains (mean square) when the rigid body is
        re-fitted, with viscous and Coulomb friction and an offset at each joint. It holds for one standard motion of
        the bundled arm; another motion gives another number. A small residual means: a fit absorbs the effect.
    """)
    lines = [head]
    families = dict.fromkeys(one.effect.family for one in examples.values())
    for family in families:
        lines += [
            f"\n## {family[0].upper()}{family[1:]}\n",
            "| | effect | torque | residual |",
            "| --- | --- | --- | --- |",
        ]
        for name, one in examples.items():
            if one.effect.family == family:
                image = f"![]({name}_small.svg){{ width=110 }}"
                cells = image, f"[{_first_up(one.effect.words)}]({name}.md)", _cell_code(one.effect.equation)
                lines.append(f"| {' | '.join(cells)} | {_remains(motion, one)} |")
    return "\n".join(lines) + "\n"


def _page(motion: Motion, one: Example, rivals: Sequence[Rival]) -> str:
    effect, place = one.effect, one.site.name(motion.robot)
    fitted = "the rigid body and friction are" if one.friction else "the rigid body is"
    plain = "" if one.friction else " Every fit includes this term, so the rigid body alone is re-fitted here."
    share = _remains(motion, one)
    return (
        "\n\n".join(
            [
                f"# {_first_up(effect.words)}",
                f"`{effect.id}` · {effect.family} · {effect.prevalence} among machines"
                + (" · alike at the joints of one robot" if effect.of_drives else ""),
                f"Torque that it adds:\n\n```text\ntau += {effect.equation}\n```",
                _meaning(effect),
                _parameters(motion, one),
                f"![Torque and residual of the effect]({effect.id}.svg)",
                f"The effect at `{place}` on the standard motion, after {fitted} re-fitted: {share} of its mean square "
                f"remains.{plain}",
                f"## What it is confused with\n\n{_confused(motion, one, rivals)}",
                f"## The motion that shows it\n\n{effect.shown_by}",
                _notes(effect),
            ]
        ).strip()
        + "\n"
    )


def _remains(motion: Motion, one: Example) -> str:
    left, all_of_it = (float(motion.columns(x[..., None]).square().sum()) for x in (one.residual, one.torque))
    return _percent(left / all_of_it)


def _percent(share: float) -> str:
    return "< 0.1 %" if share < 1e-3 else f"{100 * share:.2g} %" if share < 0.995 else "100 %"


def _confused(motion: Motion, one: Example, rivals: Sequence[Rival]) -> str:
    close = [rival for rival in rivals if rival.share < _CLOSE][:_ROWS]
    if not close:
        return f"No other effect explains more than {_percent(1 - _CLOSE)} of the residual on this motion."
    rows = [
        f"| [{x.effect.words}]({x.effect.id}.md) | `{x.site.name(motion.robot)}` | {_percent(x.share)} |" for x in close
    ]
    text = (
        "Another effect may explain the residual on this motion. The table has those that explain most, at their best "
        "place and shape. A small share means: this motion does not separate the two."
    )
    head = "| effect | at | share of the residual that remains |", "| --- | --- | --- |"
    return "\n".join([text, "", *head, *rows])


def _meaning(effect: Effect) -> str:
    """Return the first paragraph about the file, and what the class says."""
    module = inspect.getdoc(sys.modules[type(effect).__module__]) or ""
    paragraphs = [*module.split("\n\n")[:1], *(inspect.getdoc(type(effect)) or "").split("\n\n")]
    return "\n\n".join(_prose(" ".join(paragraph.split())) for paragraph in paragraphs)


def _parameters(motion: Motion, one: Example) -> str:
    values = one.effect.parameters(one.w, one.shape)
    rows = [
        f"| `{name}` | {one.effect.unit(name, prismatic=False)} | {float(values[name]):.3g} |"
        for name in one.effect.units
    ]
    return "\n".join(["| parameter | unit | in the pictures |", "| --- | --- | --- |", *rows])


def _notes(effect: Effect) -> str:
    notes = {
        "It needs": effect.needs,
        "Prior": effect.prior.words,
        "In MJCF": effect.export_note,
        "In URDF": effect.urdf_note,
    }
    rows = [f"| {name} | {_prose(text)} |" for name, text in notes.items() if text]
    return "\n".join(["## Notes", "", "| | |", "| --- | --- |", *rows]) if rows else ""


def _first_up(words: str) -> str:
    return words[0].upper() + words[1:]


def _cell_code(text: str) -> str:
    """Return code in a cell of a table, in which | would end it."""
    return f"<code>{html.escape(text).replace('|', '&#124;')}</code>"


def _prose(text: str) -> str:
    """Return text in which nothing but code has a meaning for Markdown."""
    pieces = re.split(r"(``?[^`]+``?)", text)
    return "".join(
        f"`{piece.strip('`')}`" if piece.startswith("`") else re.sub(r"([*<_|$])", r"\\\1", piece) for piece in pieces
    )


def navigation(effects: Mapping[str, Effect] | None = None) -> list[str | dict[str, list[str]]]:
    """Return the pages as mkdocs takes them: the index, then the effects of each family."""
    effects = known_effects() if effects is None else effects
    families = dict.fromkeys(effect.family for effect in effects.values())
    pages_of = {
        _first_up(family): [f"effects/{name}.md" for name, effect in effects.items() if effect.family == family]
        for family in families
    }
    return ["effects/index.md", *({family: addresses} for family, addresses in pages_of.items())]
