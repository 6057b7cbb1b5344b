"""Reads the segments of a recording (`hall.0000`, `hall.0001` ...) as one recording, `hall`."""

from __future__ import annotations

import dataclasses
import os
import time as clock
import warnings
from collections.abc import Iterator
from typing import Any, Optional, Union

from . import values
from .binary import Damaged
from .frames import FrameReader
from .progress import Progress
from .reader import AbandonedWarning, DeletedWarning, Message, Store, Stream


@dataclasses.dataclass
class _Part:
    """The messages of a stream in one segment. Messages from `until` on are hidden by a later run."""

    segment: Store
    number: int
    run: Union[str, int, None]
    stream: Stream
    until: Optional[int] = None

    @property
    def first(self) -> int:
        """The time of the first message, if there is one."""
        return self.stream.first or 0

    @property
    def last(self) -> int:
        """The time of the last message, if there is one."""
        return self.stream.last or 0


class SegmentedStore(FrameReader):
    """A recording in segments, over all runs of its recorder. It has the methods of `Store`.

    Messages of a stream are in order of time. If a later run has recorded the same times again, or the clock was set
    back, its messages replace those of earlier runs from its first message on.
    """

    def __init__(self, path: str, core: Optional[bool] = None) -> None:
        self.path, self._core = path, core
        self.name = os.path.basename(path)
        self._segments: dict[int, Store] = {}
        self._ignored: set[int] = set()
        self._unreadable: dict[int, str] = {}
        self._list_segments()
        if not self._segments:
            raise FileNotFoundError(f"no segments of {path}")

    def __repr__(self) -> str:
        return f"<situ.SegmentedStore {self.name!r} at {self.path!r}: {self.state}, {len(self._segments)} segments>"

    def refresh(self) -> bool:
        """Reads newly committed messages and finds new segments. Returns whether there were any."""
        before = list(self._segments)
        changed = False
        for segment in list(self._segments.values()):
            if segment.closed:
                continue
            try:
                changed = segment.refresh() or changed
            except FileNotFoundError:
                # It was deleted, which the list of segments shows.
                pass
        self._list_segments()
        return changed or list(self._segments) != before

    def _list_segments(self) -> None:
        versions = list_versions(self.path)
        self._segments = {number: store for number, store in self._segments.items() if number in versions}
        self._unreadable = {number: why for number, why in self._unreadable.items() if number in versions}
        for number, folder in versions.items():
            if number in self._segments or number in self._ignored:
                continue
            try:
                store = Store(folder, self._core)
            except FileNotFoundError:
                continue
            except Damaged as error:
                self._unreadable[number] = f"{os.path.basename(folder)} cannot be read: {error}"
                continue
            self._unreadable.pop(number, None)
            if store.segment is not None:
                self._segments[number] = store
            elif store.streams or store.closed:
                self._ignored.add(number)
        self._segments = dict(sorted(self._segments.items()))

    @property
    def segments(self) -> list[Store]:
        """The segments as a list of `Store`, oldest first."""
        return list(self._segments.values())

    @property
    def streams(self) -> dict[str, Stream]:
        """A dict from name to `Stream`. If a stream has had several types, the name belongs to the newest."""
        found = {}
        for name, parts in self._find_parts().items():
            infos = [part.stream for part in parts]
            written = [part for part in parts if part.stream.count > 0]
            last = written[-1] if written else None
            found[name] = dataclasses.replace(
                infos[-1],
                name=name,
                count=sum(_count_visible(part) for part in parts),
                first=written[0].stream.first if written else None,
                last=None if last is None else last.last if last.until is None else last.until - 1,
                closed=infos[-1].closed if self.state != "live" else None,
                metadata=next((info.metadata for info in reversed(infos) if info.metadata is not None), None),
            )
        return found

    def _find_parts(self) -> dict[str, list[_Part]]:
        """Returns a dict from the name of a stream to its parts in order of time."""
        found: dict[str, list[_Part]] = {}
        names: dict[tuple[str, str], str] = {}
        used: set[str] = set()
        for number, segment in reversed(self._segments.items()):
            for stream in segment.streams.values():
                key = (stream.name, stream.type)
                if key not in names:
                    names[key] = f"{stream.name} ({stream.type})" if stream.name in used else stream.name
                    used.add(names[key])
                part = _Part(segment, number, (segment.segment or {}).get("run"), stream)
                found.setdefault(names[key], []).append(part)
        return {name: _order_parts(parts[::-1]) for name, parts in sorted(found.items())}

    @property
    def closed(self) -> bool:
        """Whether the recorder has closed all segments."""
        return all(segment.closed for segment in self.segments)

    @property
    def state(self) -> str:
        """"live" while it is being written, "closed", or "abandoned" if a recorder exited without closing a segment."""
        states = {segment.state for segment in self.segments}
        return next(state for state in ("live", "abandoned", "closed") if state in states)

    @property
    def created(self) -> int:
        """The creation time of the oldest segment in nanoseconds."""
        return self.segments[0].created

    @property
    def damage(self) -> list[str]:
        """Descriptions of damaged parts that were skipped so far."""
        found = [f"{os.path.basename(s.path)}: {sentence}" for s in self.segments for sentence in s.damage]
        return found + list(self._unreadable.values())

    def read(
        self,
        name: str,
        start: Optional[int] = None,
        stop: Optional[int] = None,
        follow: bool = False,
        skip_damage: bool = False,
    ) -> Iterator[Message]:
        """Yields the messages of a stream, as `Store.read` does.

        With `follow=True`, it continues in new segments. If the recorder deletes a segment before it was read, the
        iteration continues with the next one, after a `DeletedWarning`.
        """
        if name not in self._find_parts():
            raise KeyError(f"unknown stream {name!r}; the streams are {sorted(self._find_parts())}")
        last = None if start is None else start - 1
        while True:
            # Read the state before the messages: after the end, nothing follows.
            state = self.state
            try:
                for message in self._read_parts(name, last, stop, skip_damage):
                    last = message.time
                    yield message
            except FileNotFoundError as error:
                numbers = set(self._segments)
                self.refresh()
                if numbers <= set(self._segments):
                    raise
                text = f"{self.path}: messages were deleted before they were read ({error})"
                warnings.warn(text, DeletedWarning, stacklevel=2)
                continue
            if not follow or state == "closed" or (stop is not None and last is not None and last >= stop):
                return
            if not self.refresh() and state != "live":
                warnings.warn(f"{self.path}: the writer exited without closing it", AbandonedWarning, stacklevel=2)
                return
            if state == "live":
                clock.sleep(0.02)

    def _read_parts(
        self, name: str, last: Optional[int], stop: Optional[int], skip_damage: bool, lazy: bool = False
    ) -> Iterator[Message]:
        for part in self._find_parts().get(name, []):
            info = part.stream
            if not info.count or (last is not None and part.last <= last) or (stop is not None and part.first > stop):
                continue
            start, limit = None if last is None else last + 1, _limit(part, stop)
            if lazy:
                yield from part.segment._read_range(info.name, start, limit, skip_damage)
            else:
                yield from part.segment.read(info.name, start, limit, skip_damage=skip_damage)

    def _read_table(
        self, name: str, start: Optional[int], stop: Optional[int], skip_damage: bool, report: Progress
    ) -> Optional[dict[str, Any]]:
        """Returns the columns of a stream of maps, or None if the messages have to be read one by one."""
        np = values.import_numpy()
        tables: list[dict[str, Any]] = []
        for part in self._find_parts().get(name, []):
            is_outside = (start is not None and part.last < start) or (stop is not None and part.first > stop)
            if is_outside or not part.stream.count:
                continue
            limit = _limit(part, stop)
            table = part.segment._read_table(part.stream.name, start, limit, skip_damage, report)
            if table is None or (tables and _describe_columns(table) != _describe_columns(tables[0])):
                return None
            tables.append(table)
        if len(tables) < 2:
            return tables[0] if tables else None
        return {key: np.concatenate([table[key] for table in tables]) for key in tables[0]}

    def _read_range(self, name: str, start: Optional[int], stop: Optional[int], skip_damage: bool) -> Iterator[Message]:
        """Yields the messages of a stream like `read`, but large ones as `Lazy`."""
        return self._read_parts(name, None if start is None else start - 1, stop, skip_damage, True)

    def array(
        self,
        name: str,
        start: Optional[int] = None,
        stop: Optional[int] = None,
        skip_damage: bool = False,
        progress: Optional[bool] = None,
    ) -> tuple[Any, Any]:
        """Returns the times (int64, ns) and values of a stream as two numpy arrays, as `Store.array` does."""
        np = values.import_numpy()
        if name not in self._find_parts():
            raise KeyError(f"unknown stream {name!r}; the streams are {sorted(self._find_parts())}")
        found = [
            part.segment.array(part.stream.name, start, _limit(part, stop), skip_damage, progress)
            for part in self._find_parts()[name]
            if part.stream.count
        ]
        found = [columns for columns in found if len(columns[0])]
        if not found:
            return np.array([], "i8"), np.array([])
        return np.concatenate([times for times, _ in found]), np.concatenate([data for _, data in found])


def _describe_columns(table: dict[str, Any]) -> list[tuple[str, Any]]:
    return [(name, column.dtype) for name, column in table.items()]


def _limit(part: _Part, stop: Optional[int]) -> Optional[int]:
    if part.until is None:
        return stop
    return part.until - 1 if stop is None else min(stop, part.until - 1)


def _count_visible(part: _Part) -> int:
    if part.until is None:
        return part.stream.count
    return sum(1 for _ in part.segment.read(part.stream.name, stop=part.until - 1, skip_damage=True))


def _order_parts(parts: list[_Part]) -> list[_Part]:
    """Orders the parts by run and time. A later run hides messages of earlier runs at or after its first message."""
    empty = [part for part in parts if not part.stream.count]
    runs: dict[Any, list[_Part]] = {}
    for part in _separate_unmarked([part for part in parts if part.stream.count]):
        runs.setdefault(part.run, []).append(part)
    ordered: list[_Part] = []
    for run in sorted(runs.values(), key=lambda parts: min(part.number for part in parts)):
        for part in sorted(run, key=lambda part: part.first):
            while ordered and ordered[-1].run != part.run and ordered[-1].last >= part.first:
                if ordered[-1].first < part.first:
                    ordered[-1].until = part.first
                    break
                ordered.pop()
            ordered.append(part)
    return empty + ordered if ordered else empty


def _separate_unmarked(parts: list[_Part]) -> list[_Part]:
    """Segments of earlier releases have no run. If they overlap, each of them counts as one."""
    unmarked = sorted((part for part in parts if part.run is None), key=lambda part: part.first)
    if any(b.first <= a.last for a, b in zip(unmarked, unmarked[1:])):
        for part in unmarked:
            part.run = part.number
    return parts


def list_versions(path: str) -> dict[int, str]:
    """Returns the folders of all versions of a name, by number."""
    root, name = os.path.split(path)
    root = root or "."
    if not os.path.isdir(root):
        return {}
    prefix = name + "."
    endings = [full[len(prefix) :] for full in os.listdir(root) if full.startswith(prefix)]
    numbers = sorted(int(ending) for ending in endings if ending.isdigit() and 4 <= len(ending) <= 9)
    return {number: os.path.join(root, f"{prefix}{number:04}") for number in numbers}


def open_path(path: str, core: Optional[bool] = None) -> Union[Store, SegmentedStore]:
    """Opens a store's folder, all segments of `root/name`, or its newest version."""
    if not os.path.exists(os.path.join(path, "index.situ")):
        for folder in reversed(list_versions(path).values()):
            try:
                store = Store(folder, core)
            except (FileNotFoundError, Damaged):
                # A crash may have left a version without an index.
                continue
            if store.segment is None and not store.streams and len(list_versions(path)) > 1:
                # A recorder has just begun, or was killed at that moment.
                continue
            return store if store.segment is None else SegmentedStore(path, core)
        path = next(reversed(list_versions(path).values()), path)
    return Store(path, core)
