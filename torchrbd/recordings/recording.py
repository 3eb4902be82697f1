"""Open a recording and stream its rows in SI units, with the joints in the robot's order."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path

import numpy as np

from torchrbd.display import Remark, brief, few
from torchrbd.errors import RecordingError
from torchrbd.recordings.chunk import Chunk
from torchrbd.recordings.drives import Drives
from torchrbd.recordings.formats.opening import open_table
from torchrbd.recordings.formats.table import ArrayTable, Table
from torchrbd.recordings.layouts import with_layout
from torchrbd.recordings.mapping import Mapping as ColumnMapping
from torchrbd.recordings.mapping import Source
from torchrbd.recordings.matching import PARTIAL_SIGNALS, match
from torchrbd.recordings.memory import Data, memory_table

# Larger values could overflow in squares of sums; times in ns since 1970 are far below.
_LARGEST = 1e20


@dataclass(frozen=True)
class Recording:
    """A recording that fits a robot; ``chunks`` streams its rows any number of times.

    Attributes:
        name: the file's name, or the name of data in memory.
        path: of the file; None for data in memory.
        joints: the robot's joints, in its order.
        drives: of the joints whose torque is computed from the set-points.
        time: the part in use, seconds since the first row; None for all.
        notes: what is in the file but not used.
        torque_delay_s: delay of written torques relative to the positions that they belong to [s]. Rows are as written;
            states have both at one time.
    """

    name: str
    path: Path | None
    joints: tuple[str, ...]
    drives: Drives
    time: tuple[float, float] | None
    notes: tuple[Remark, ...]
    _table: Table
    _sources: dict[str, tuple[Source, ...]]
    _there: dict[str, np.ndarray]
    torque_delay_s: float = 0.0

    @property
    def unknown_gains(self) -> tuple[str, ...]:
        """Joints whose torque has a factor that is to be estimated: a drive's stiffness, a motor's torque constant."""
        pairs = zip(self._joints_with("tau"), self._sources.get("tau", ()), strict=True)
        unknown = {*self.drives.unknown, *(joint for joint, source in pairs if not source.is_known)}
        return tuple(joint for joint in self.joints if joint in unknown)

    def with_gains(self, gains: Mapping[str, float]) -> Recording:
        """Return the recording with factors of torques that were to be estimated, by joint.

        Args:
            gains: stiffness of drives [N m/rad, N/m], torque constants of motors [N m/A, N/A].
        """
        return replace(
            self, drives=self.drives.with_stiffness(gains), _sources=self._sources | self._scaled_currents(gains)
        )

    @property
    def in_own_units(self) -> Recording:
        """The same with factors of one: position errors [rad, m] and currents [A] in place of unknown torques."""
        currents = self._scaled_currents(dict.fromkeys(self.unknown_gains, 1.0))
        return replace(self, drives=self.drives.with_unit_stiffness(), _sources=self._sources | currents)

    def _scaled_currents(self, gains: Mapping[str, float]) -> dict[str, tuple[Source, ...]]:
        """Return the sources of torques, those of unknown torque constants with these."""
        found = list[Source]()
        for joint, source in zip(self._joints_with("tau"), self._sources.get("tau", ()), strict=True):
            known = source.is_known or joint not in gains
            found.append(source if known else replace(source, scale=gains[joint] * source.scale, is_known=True))
        return {"tau": tuple(found)} if found else {}

    @property
    def measured(self) -> np.ndarray:
        """Which joints have a torque, recorded or of a drive, (n,) bool."""
        return self._there["tau"] | np.array([joint in self.drives.of for joint in self.joints])

    @property
    def has_velocity(self) -> bool:
        """Whether every joint has a measured velocity."""
        return bool(self._there["qd"].all())

    @property
    def has_acceleration(self) -> bool:
        """Whether every joint has a measured acceleration."""
        return bool(self._there["qdd"].all())

    @property
    def has_reference(self) -> bool:
        """Whether every joint has a set-point."""
        return bool(self._there["q_ref"].all())

    @property
    def referenced(self) -> np.ndarray:
        """Which joints have a set-point that is used, (n,) bool: all, or those with a drive."""
        return self._there["q_ref"]

    @property
    def linked(self) -> np.ndarray:
        """Which joints have an encoder behind the gear too, (n,) bool."""
        return self._there["q_link"]

    @property
    def thermal(self) -> np.ndarray:
        """Which joints have a temperature, (n,) bool."""
        return self._there["temperature"]

    def __repr__(self) -> str:
        return brief(
            self,
            name=self.name,
            joints=few(self.joints),
            torques=int(self.measured.sum()),
            velocity=self.has_velocity,
            set_points=self.has_reference,
            time=self.time,
        )

    @staticmethod
    def from_arrays(
        name: str,
        joints: Sequence[str],
        t: np.ndarray,
        q: np.ndarray,
        tau: np.ndarray,
        qd: np.ndarray | None = None,
        qdd: np.ndarray | None = None,
        q_ref: np.ndarray | None = None,
        q_link: np.ndarray | None = None,
        temperature: np.ndarray | None = None,
    ) -> Recording:
        """Make a recording from arrays: t (N,) [s]; all others (N, n), columns in the order of `joints`.

        A column of tau, q_ref, q_link or temperature that is all NaN was not recorded for that joint.

        Raises: RecordingError naming the array whose shape does not fit.
        """
        columns = {"t": np.asarray(t, dtype=np.float64)}
        signals = {"q": q, "tau": tau, "qd": qd, "qdd": qdd, "q_ref": q_ref, "q_link": q_link}
        signals["temperature"] = temperature
        for signal, array in signals.items():
            if array is None:
                continue
            array = np.asarray(array, dtype=np.float64)
            if array.shape != (len(t), len(joints)):
                raise RecordingError(
                    f"{name}: {signal} has shape {array.shape}; expected ({len(t)}, {len(joints)}) for {len(t)} times "
                    f"and joints {', '.join(joints)}"
                )
            for index, joint in enumerate(joints):
                if signal not in PARTIAL_SIGNALS or not np.isnan(array[:, index]).all():
                    columns[f"{signal}_{joint}"] = array[:, index]
        return connect(name, None, ArrayTable(columns), joints, ColumnMapping(), None)

    def of_joints(self, joints: Sequence[str], time: tuple[float, float] | None = None) -> Recording:
        """Return the recording with its joints in another order, and only a part of it if `time` is given.

        Raises: RecordingError if its joints are others.
        """
        if set(joints) != set(self.joints):
            raise RecordingError(
                f"{self.path or self.name}: is of joints {', '.join(self.joints)}; expected {', '.join(joints)}"
            )
        order = [self.joints.index(joint) for joint in joints]
        sources = {key: group for key, group in self._sources.items() if key == "t"}
        for key in self._sources.keys() - {"t"}:
            own = dict(zip(self._joints_with(key), self._sources[key], strict=True))
            sources[key] = tuple(own[joint] for joint in joints if joint in own)
        return replace(
            self,
            joints=tuple(joints),
            drives=self.drives.of_joints(joints),
            time=time or self.time,
            _sources=sources,
            _there={key: some[order] for key, some in self._there.items()},
        )

    def source(self, signal: str, joint: str) -> Source | None:
        """Return the source of a joint's signal, e.g. ("tau", "joint3"), or of the time for "t"; None if missing."""
        found = self._sources.get(signal, ())
        if signal == "t":
            return found[0]
        return dict(zip(self._joints_with(signal), found, strict=False)).get(joint)

    def _joints_with(self, signal: str) -> Sequence[str]:
        return self.joints if signal == "q" else tuple(compress(self.joints, self._there[signal]))

    def chunks(self, rows: int = 16384) -> Iterator[Chunk]:
        """Yield the rows in chunks of at most about `rows`.

        Raises: RecordingError naming the column and data row of an infinite value or of a time that goes backwards, or
        the joints whose torque has an unknown factor.
        """
        if unknown := self.unknown_gains:
            raise RecordingError(
                f"{self.path or self.name}: the mapping leaves the gain of {', '.join(unknown)} to 'torchrbd identify' "
                "and 'diagnose'; for other commands, write the number that these report in place of 'estimate'"
            )
        found = self._as_written(rows)
        return self.drives.with_torque(found) if self.drives.of else found

    def _as_written(self, rows: int) -> Iterator[Chunk]:
        """Yield the rows, without the torques of drives."""
        sources = [source for group in self._sources.values() for source in group]
        columns = list(dict.fromkeys(source.column for source in sources))
        where = {column: index for index, column in enumerate(columns)}
        slots = {key: [where[source.column] for source in group] for key, group in self._sources.items()}
        scales = {key: np.array([source.scale for source in group]) for key, group in self._sources.items()}
        offsets = {key: np.array([source.offset for source in group]) for key, group in self._sources.items()}
        first_row, start, latest = 1, np.nan, -np.inf
        for block in self._table.batches(columns, rows):
            self._check_finite(block, columns, first_row)
            values = {key: block[slots[key]].T * scales[key] + offsets[key] for key in slots}
            t = values["t"][:, 0]
            known = t[~np.isnan(t)]
            if np.isnan(start) and len(known):
                start = known[0]
            self._check_order(t, latest, first_row)
            latest = known[-1] if len(known) else latest
            first_row += len(t)
            others = np.ones(len(columns), dtype=bool)
            others[slots["t"]] = False
            present = ~np.isnan(block[others]).all(axis=0)  # the others are rows of other topics
            if not present.any():
                continue
            if not present.all():
                t, values = t[present], {key: value[present] for key, value in values.items()}
            chunk = self._assemble(t - start, values)
            if chunk is not None:
                yield chunk

    def _assemble(self, t: np.ndarray, values: dict[str, np.ndarray]) -> Chunk | None:
        keep = slice(None)
        if self.time is not None:
            keep = (t >= self.time[0]) & (t <= self.time[1])
            if not keep.any():
                return None
        optional = {}
        for key, there in self._there.items():
            if there.any() or key == "tau":
                whole = np.full((len(t), len(self.joints)), np.nan)
                if there.any():
                    whole[:, there] = values[key]
                optional[key] = whole[keep]
        return Chunk(t[keep], values["q"][keep], **optional)

    def _check_finite(self, block: np.ndarray, columns: list[str], first_row: int) -> None:
        if np.isinf(block).any():
            row, column = np.argwhere(np.isinf(block.T))[0]
            raise RecordingError(
                f"{self.path or self.name}: column '{columns[column]}', data row {first_row + row}: infinite value; "
                f"leave a missing cell empty or write nan"
            )
        with np.errstate(invalid="ignore"):
            beyond = np.abs(block) > _LARGEST
        if beyond.any():
            row, column = np.argwhere(beyond.T)[0]
            raise RecordingError(
                f"{self.path or self.name}: column '{columns[column]}', data row {first_row + row}: "
                f"{block.T[row, column]:.3g} is more than any sensor gives; correct the column, or its scale and unit "
                "in the mapping"
            )

    def _check_order(self, t: np.ndarray, latest: float, first_row: int) -> None:
        rows = np.flatnonzero(~np.isnan(t))
        steps = np.diff(t[rows], prepend=latest if np.isfinite(latest) else t[rows[:1]])
        if (steps < 0).any():
            row = int(rows[np.argmax(steps < 0)])
            raise RecordingError(
                f"{self.path or self.name}: data row {first_row + row}: time goes backwards, to {t[row]:.9g} s; "
                f"sort the rows, or split the file where two recordings were joined"
            )


def open_recording(
    source: str | Path | Data,
    joints: Sequence[str],
    *,
    mapping: ColumnMapping | None = None,
    time: tuple[float, float] | None = None,
    name: str | None = None,
) -> Recording:
    """Open a recording in a file, a folder or in memory, and check that its columns fit the robot's joints.

    Files are CSV, Parquet, NPZ, MATLAB (.mat) and, with joint states, ROS bags (.bag, .mcap, .db3); folders are ROS 2
    bags and LeRobot data sets.

    Data in memory are not copied: do not change them while they are in use. They are

    - a table with a CSV file's columns: a ``pandas.DataFrame``, or any object with ``columns`` and
      ``table[column].to_numpy()``,
    - or a dict of arrays, lists or tensors: with the same columns (N,), or, as in NPZ files, with ``t`` (N,), ``q``,
      ``tau`` and optional ``qd``, ``qdd``, ``q_ref``, ``q_link``, ``temperature`` (N, n) and the joints'
      names in ``joints`` (n,). Without ``joints``, n must be the robot's number of joints, in the robot's order.

    Example:

        recording = torchrbd.open_recording({"t": t, "q": q, "tau": tau}, robot.joint_names, name="monday")

    Args:
        source: a file or folder, a table, or a dict.
        joints: the robot's joints, in its order.
        mapping: the columns' names, units and signs, if they differ from the defaults.
        time: use only this part, (from, to) in seconds since the recording's first row.
        name: its name in results; default: the file's name, or "recording".

    Raises: RecordingError naming the columns that are missing, those present, and the closest matches; also for data in
    memory that are not numbers or have different lengths.
    """
    place = str(source) if isinstance(source, (str, Path)) else name or "recording"
    if time is not None and not time[0] < time[1]:
        raise RecordingError(f"{place}: time {time[0]:g}:{time[1]:g} s is empty; expected from < to")
    mapping = mapping or ColumnMapping()
    mapping.check_joints(joints)
    if isinstance(source, (str, Path)):
        path = Path(source)
        return connect(name or path.name, path, open_table(path, mapping), joints, mapping, time)
    table = memory_table(source, joints, place)
    recording = connect(place, None, table, joints, mapping, time)
    table.check([one.column for group in recording._sources.values() for one in group])
    return recording


def connect(
    name: str,
    path: Path | None,
    table: Table,
    joints: Sequence[str],
    mapping: ColumnMapping,
    time: tuple[float, float] | None,
    torque: bool = True,
) -> Recording:
    """Make a recording of a table whose columns fit the joints.

    Args:
        name: its name in results.
        path: of the file; None for data in memory.
        table: its columns.
        joints: the robot's, in its order.
        mapping: names of the columns.
        time: the part in use, None for all.
        torque: whether at least one joint must have a torque.

    Raises:
        RecordingError: columns are missing.
    """
    place = str(path or name)
    found = match(table.columns, joints, with_layout(table.columns, mapping, place), place, torque)
    return Recording(
        name=name,
        path=path,
        joints=tuple(joints),
        drives=Drives(tuple(joints), found.drives, mapping.set_point_delay_s),
        time=time,
        notes=found.notes,
        _table=table,
        _sources=found.sources,
        _there=found.there,
        torque_delay_s=mapping.torque_delay_s,
    )
