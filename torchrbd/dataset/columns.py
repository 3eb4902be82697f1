"""The coefficient vector x = [pi, w] of a robot with candidate terms, and the feature columns that multiply it.

    tau_j = Y_j pi + sum_k phi_jk w_jk

A joint's torque depends on the bodies that it moves, on its own features, and on those of whole-robot effects. So joint
j has the columns ``of_joint[j]`` of x and no others.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from torchrbd.dataset.sticking import stick_weight, undetermined
from torchrbd.effects import Effect, JointScale, Shape, Signals, Site, Window
from torchrbd.effects.base import ShowsBodies
from torchrbd.effects.plain_friction import plain_friction
from torchrbd.effects.registry import tagged_effects
from torchrbd.errors import InputError
from torchrbd.recordings import States
from torchrbd.robot import RobotModel


@dataclass(frozen=True)
class Candidate:
    """An effect at a site with its shape parameters fixed: a set of columns."""

    effect: Effect
    site: Site
    shape: Shape = field(hash=False)
    labels: tuple[str, ...]

    @property
    def joint(self) -> int:
        """The joint where it acts; only for effects at one joint."""
        assert self.site.joint is not None, f"{self.effect.id} sits at no joint"
        return self.site.joint

    @property
    def place(self) -> int | None:
        """The joint whose torque it adds to; None for the whole robot."""
        return None if self.effect.whole_robot else self.site.joint

    def features(self, signals: Signals) -> dict[str, Tensor]:
        """Return the columns by label, as ``Effect.features`` does."""
        return self.effect.features_at(signals, self.site, self.shape)


Through = tuple[tuple[ShowsBodies, Tensor], ...]
"""Effects that make inertial parameters identifiable, with their coefficients (K,)."""


class Columns:
    """The layout of x for one robot, a set of effects and the ranges that the recordings cover.

    Args:
        robot: the robot.
        effects: effects to have columns for.
        scales: per joint, the range that the recordings cover.
        windows: windows of time in which effects may act.
        pi: (n_params,) inertial parameters for the load; the URDF's if None.
        friction: (n_dof, 3) friction that actuators supply in addition to the load, see ``Signals``; none if None.
        sites: by an effect's id, its sites with columns; all its sites if not given.
        candidates: all that has columns; if None, every effect at its sites with every shape of its grid.
        stick_levels: (n_dof,) Coulomb friction in standard deviations of each torque's noise; none if not given.
        through: effects that make inertial parameters identifiable, see ``bodies``.
        unsure: (n_dof,) speeds below which a joint may stick, see ``undetermined``; the ``rest_width`` of the scales if
            None.

    Attributes:
        effects, scales, windows, pi, friction, sites, stick_levels, through, unsure: as given.
        n: length of x.
        labels: per joint, labels of its own features.
        shared: labels of the features that all joints have.
        of_joint: per joint, indices in x of its columns: inertial ones of the bodies it moves, its features, shared
            ones.
        candidates: all that has columns, apart from the rigid body.
        urdf_friction: the terms that the URDF's <dynamics> tags can hold, at every joint.
    """

    def __init__(
        self,
        robot: RobotModel,
        effects: Iterable[Effect],
        scales: Sequence[JointScale],
        windows: Sequence[Window] = (),
        pi: Tensor | None = None,
        *,
        friction: Tensor | None = None,
        sites: Mapping[str, Collection[Site]] | None = None,
        candidates: Iterable[Candidate] | None = None,
        stick_levels: Tensor | None = None,
        through: Through = (),
        unsure: Tensor | None = None,
    ) -> None:
        self.robot, self.effects, self.scales, self.windows = robot, tuple(effects), tuple(scales), tuple(windows)
        self.pi, self.friction, self.through, self.unsure = pi, friction, through, unsure
        self._rest_width = torch.tensor([s.rest_width for s in self.scales], dtype=torch.float64)
        self.sites = dict(sites or {})
        self.stick_levels = torch.zeros(robot.n_dof, dtype=torch.float64) if stick_levels is None else stick_levels
        still = torch.zeros(3, robot.n_dof, 4, dtype=torch.float64)
        self._asked_for: dict[Hashable, Candidate] = {}
        self._made_by_motion: dict[int, Tensor] = {}
        self._probe = replace(self.signals_at(*still), t=torch.arange(4, dtype=torch.float64))
        self.urdf_friction = tuple(
            self.candidate(e, Site(joint), {}) for joint in range(robot.n_dof) for e in tagged_effects()
        )
        self.candidates = tuple(self._grid() if candidates is None else candidates)
        self._maker: dict[tuple[int | None, str], Candidate] = {}
        for candidate in (*self.urdf_friction, *self.candidates):
            for label in candidate.labels:
                self._maker.setdefault((candidate.place, label), candidate)
        self.labels = tuple(tuple(label for at, label in self._maker if at == j) for j in range(robot.n_dof))
        self.shared = tuple(label for at, label in self._maker if at is None)
        own = [(j, label) for j, labels in enumerate(self.labels) for label in labels]
        places: list[tuple[int | None, str]] = [*own, *((None, label) for label in self.shared)]
        self._index = {place: robot.n_params + k for k, place in enumerate(places)}
        self.n = robot.n_params + len(places)
        self.inertial = [robot.columns(joint) for joint in range(robot.n_dof)]
        self.of_joint = tuple(
            torch.cat((self.inertial[j], torch.tensor([self._index[p] for p in places if p[0] in (j, None)]).long()))
            for j in range(robot.n_dof)
        )

    @property
    def labels_of_joint(self) -> tuple[tuple[str, ...], ...]:
        """Per joint, labels of its features and of shared ones, in the order of ``of_joint``."""
        return tuple((*own, *self.shared) for own in self.labels)

    def _grid(self) -> Iterator[Candidate]:
        for e in {e.id: e for e in self.effects}.values():
            for site in self.sites.get(e.id, e.sites(self.robot) or e.sites(self.robot, self.windows)):
                for shape in e.shapes(self.scale(site)):
                    yield self.candidate(e, site, shape)

    def candidate(self, e: Effect, site: Site, shape: Shape) -> Candidate:
        """Return an effect at a site with a shape, whether or not it has columns here."""
        key = e, site, *shape.items()
        if key not in self._asked_for:
            self._asked_for[key] = Candidate(e, site, shape, tuple(e.features_at(self._probe, site, shape)))
        return self._asked_for[key]

    def scale(self, site: Site) -> JointScale:
        """Return the range of a site's joint that the recordings cover; for the whole robot, of the first joint."""
        j = site.joint or 0
        return replace(self.scales[j], lower=float(self.robot.lower[j]), upper=float(self.robot.upper[j]))

    def at_scales(self, scales: Sequence[JointScale]) -> Columns:
        """Return columns of the same effects for other scales."""
        return self._like(scales=scales)

    def softened(self, scales: Sequence[JointScale]) -> Columns:
        """Return columns of the same effects with the ``rest_width`` of other scales.

        The speeds at which a joint may stick do not change: friction with a wide sign change is still determined there.
        """
        return self._like(scales=scales, unsure=self.slow)

    @property
    def slow(self) -> Tensor:
        """Speeds (n_dof,) below which the direction of motion is uncertain [rad/s, m/s]."""
        return self._rest_width if self.unsure is None else self.unsure

    def local(self, joint: int, label: str) -> int:
        """Return the index of one of a joint's own features among its columns."""
        return len(self.inertial[joint]) + self.labels[joint].index(label)

    def made_by_motion(self, joint: int) -> Tensor:
        """Return which columns (p_j,) of a joint are zero whenever that joint is at rest, bool."""
        if joint not in self._made_by_motion:
            generator = torch.Generator().manual_seed(0)
            q, qd, qdd = torch.randn(3, self.robot.n_dof, 4, generator=generator, dtype=torch.float64)
            qd[joint] = qdd[joint] = 0.0
            self._made_by_motion[joint] = self._own_power(joint, q, qd, qdd) == 0.0
        return self._made_by_motion[joint]

    def in_unit_motion(self, joint: int) -> Tensor:
        """Return the size of the columns (p_j,) of a joint that its own motion makes; zero for others.

        All joints move at 1 rad/s or m/s, and accelerate at 1 rad/s^2 or m/s^2.
        """
        q, one = torch.zeros(2, self.robot.n_dof, 4, dtype=torch.float64)
        one += 1.0
        return torch.where(self.made_by_motion(joint), self._own_power(joint, q, one, one), 0.0).sqrt()

    def _own_power(self, joint: int, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """Return the mean square of the columns that act at a joint all the time, (p_j,); NaN for its other columns."""
        signals = replace(self.signals_at(q, qd, qdd), t=self._probe.t)
        found = torch.full((self.n,), torch.nan, dtype=torch.float64)
        for (place, _), c in self._maker.items():
            if place == joint and c.site.always:
                features = torch.stack(list(c.features(signals).values()))
                found[self.of(c)] = features.square().mean(1)
        return found[self.of_joint[joint]]

    def around(self, pi: Tensor, friction: Tensor | None = None) -> Columns:
        """Return the same columns with the torque of pi (n_params,) as load, and with friction (n_dof, 3)."""
        return self.of_candidates(self.candidates, pi, friction)

    def of_candidates(
        self,
        candidates: Iterable[Candidate],
        pi: Tensor | None,
        friction: Tensor | None = None,
        through: Through | None = None,
    ) -> Columns:
        """Return columns of these candidates only, with the torque of pi and friction as in ``around``.

        ``through`` is as in ``shown_bodies``; without it, the present one stays.
        """
        through = self.through if through is None else through
        return self._like(pi=pi, friction=friction, candidates=candidates, through=through)

    def shown_bodies(self, terms: Sequence[Candidate], x: Tensor) -> Through:
        """Return ``through`` for a model x (n,) of these terms."""
        always = (c for c in terms if c.site.always)
        return tuple((c.effect, x[self.of(c)]) for c in always if isinstance(c.effect, ShowsBodies))

    def bodies(self, states: States) -> tuple[Tensor, Tensor | None]:
        """Return the factor of the inertial parameters on a tile, (n_dof, n_params, N), and a torque to add.

        The latter is (n_dof, N), or None. The columns of a term through which bodies act contain the torque of ``pi``.
        Other parameters pi' add C (pi' - pi) to it, where C is its ``through_bodies``.
        """
        Y = self.robot.regressor_batch_last(states.q, states.qd, states.qdd)
        if self.pi is None or not self.through:
            return Y, None
        signals = self.signals(states)
        C = torch.stack([effect.through_bodies(signals, w) for effect, w in self.through]).sum(0)
        return Y + C, torch.einsum("jpn,p->jn", C, self.pi)

    def sticking(self, levels: Tensor) -> Columns:
        """Return the same columns for joints with these ``stick_levels`` (n_dof,) of dry friction."""
        return self._like(candidates=self.candidates, stick_levels=levels)

    @property
    def unweighted(self) -> Columns:
        """The same columns, every row counting alike."""
        return self.sticking(torch.zeros_like(self.stick_levels)) if bool(self.stick_levels.any()) else self

    def _like(self, **other: Any) -> Columns:
        kept = ("robot", "effects", "scales", "windows", "pi", "friction", "sites", "stick_levels", "through", "unsure")
        return Columns(**({name: getattr(self, name) for name in kept} | other))

    def taken_from(self, other: Columns, x: Tensor) -> Tensor:
        """Return x (n,) with the inertial parameters and friction of another layout's x, and other terms at zero."""
        taken = self.reference()
        taken[: self.robot.n_params] = x[: self.robot.n_params]
        for own, theirs in zip(self.urdf_friction, other.urdf_friction, strict=True):
            taken[self.of(own)] = x[other.of(theirs)]
        return taken

    def index(self, joint: int | None, label: str) -> int:
        """Return the index in x of a joint's feature, or of one that all joints share (None)."""
        return self._index[joint, label]

    def of(self, candidate: Candidate) -> list[int]:
        """Return the indices in x of a candidate's columns."""
        return [self.index(candidate.place, label) for label in candidate.labels]

    def reference(self) -> Tensor:
        """Return x0 (n,): the inertial parameters and the <dynamics> friction of the URDF."""
        x = torch.zeros(self.n, dtype=torch.float64)
        x[: self.robot.n_params] = self.robot.pi
        for friction in self.urdf_friction:
            (k,) = self.of(friction)
            x[k] = self.urdf_value(friction)
        return x

    def urdf_value(self, candidate: Candidate) -> float:
        """Return the value of a term in the URDF's <dynamics>, zero if URDF cannot express it."""
        attribute = candidate.effect.urdf_tag if candidate.site.always else ""
        return float(getattr(self.robot, attribute)[candidate.joint]) if attribute else 0.0

    def friction_of(self, terms: Iterable[Candidate], x: Tensor) -> Tensor:
        """Return the friction (n_dof, 3) of a model with coefficients x (n,): of its terms, else of the URDF.

        Only terms that act all the time count.
        """
        found: list[tuple[Effect, int | None, Tensor]] = []
        counted: set[int] = set()
        for c in (*(c for c in terms if c.site.always), *self.urdf_friction):
            # A column that two terms share counts once.
            index = self.of(c)
            found.append((c.effect, c.place, torch.stack([x[k] * float(k not in counted) for k in index])))
            counted.update(index)
        return plain_friction(self.robot.n_dof, found)

    def weight(self, states: States) -> Tensor:
        """Return the weights of a tile's samples, (n_dof, M).

        They are smaller where a joint with dry friction may stick.
        """
        unknown = states.decimate(undetermined(states.qd, self.slow)).abs()
        # The filtered trace of a stick crosses zero next to it; that of the friction in it does so elsewhere.
        unknown = torch.nn.functional.max_pool1d(unknown, 3, stride=1, padding=1)
        return stick_weight(unknown, self.stick_levels)

    def signals(self, states: States) -> Signals:
        """Return the signals of a tile, time last; their load includes the known load of the robot."""
        signals = self.signals_at(states.q, states.qd, states.qdd)
        if states.loaded is not None:
            signals = replace(signals, pi=states.loaded + (self.robot.pi if self.pi is None else self.pi))
        signals = replace(signals, t=states.t, recording=states.recording, turned=states.turned)
        return replace(signals, temperature=states.temperature)

    def signals_at(self, q: Tensor, qd: Tensor, qdd: Tensor) -> Signals:
        """Return the signals of states (n_dof, N) that are not a sequence."""
        return Signals(self.robot, q, qd, qdd, self._rest_width, self.pi, friction=self.friction)

    def evaluated(self, signals: Signals, candidates: Iterable[Candidate]) -> dict[int, Tensor]:
        """Return the features of candidates by their index in x, (N,) each, or (n_dof, N) where all joints share it.

        Features that need a sequence are omitted if the signals are none.
        """
        found: dict[int, Tensor] = {}
        for candidate in candidates:
            index = self.of(candidate)
            if not found.keys() >= set(index) and (signals.t is not None or not self._needs_sequence(candidate)):
                found.update(zip(index, candidate.features(signals).values(), strict=True))
        return found

    def _needs_sequence(self, candidate: Candidate) -> bool:
        try:
            candidate.features(replace(self._probe, t=None))
        except InputError:
            return True
        return False

    def features(self, states: States) -> list[Tensor]:
        """Evaluate all features on a tile of N samples: per joint (K_j, N), in the order of ``of_joint``."""
        return self.features_of(self.signals(states))

    def features_of(self, signals: Signals) -> list[Tensor]:
        """Evaluate all features on signals of N samples, as ``features`` does."""
        found = self.evaluated(signals, self._maker.values())
        return [
            torch.stack([v if v.ndim == 1 else v[j] for v in (found[k] for k in self.of_joint[j][len(own) :].tolist())])
            for j, own in enumerate(self.inertial)
        ]

    def term_torque(self, signals: Signals, x: Tensor) -> Tensor:
        """Return the torque of the features with coefficients x, (n_dof, N)."""
        needed = [(place, c) for place, c in self._maker.items() if x[self._index[place]] != 0.0]
        found = self.evaluated(signals, [c for _, c in needed])
        torque = list(torch.zeros_like(signals.q).unbind(0))
        for place, _ in needed:
            joint, k = place[0], self._index[place]
            for j in range(len(torque)) if joint is None else (joint,):
                torque[j] = torque[j] + x[k] * (found[k][j] if joint is None else found[k])
        return torch.stack(torque)
