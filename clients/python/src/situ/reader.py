"""Reads stores: `situ.open("recordings/lobby")`."""

from __future__ import annotations

import base64
import binascii
import dataclasses
import functools
import os
import time as clock
import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Callable, Optional, Union

from . import terms, values
from .binary import BINARIES, BOOLEANS, CODEC, FLOATS, INTS, TERMS, Damaged
from .core import open_files
from .frames import FrameReader
from .layout import ChunkRange
from .lazy import Lazy
from .progress import Progress

if TYPE_CHECKING:
    from .segments import SegmentedStore

Path = Union[str, "os.PathLike[str]"]
AnyStore = Union["Store", "SegmentedStore"]
Bound = Optional[int]


@dataclasses.dataclass
class Message:
    """Data with its originating time and the time at which the message was created."""

    time: int
    data: Any
    creation: Optional[int] = None
    sequence: Optional[int] = None


@dataclasses.dataclass
class Stream:
    """One stream of a store."""

    name: str
    type: str
    count: int
    first: Optional[int] = None
    last: Optional[int] = None
    closed: Optional[int] = None
    metadata: Any = None


class AbandonedWarning(UserWarning):
    """Warns that the writer of a followed store was killed, so that no more messages will arrive."""


class DeletedWarning(UserWarning):
    """Warns that the recorder has deleted a segment before a reader could read all of it."""


def open(path: Path, core: Optional[bool] = None) -> AnyStore:
    """Opens a store: `path` is its folder, or `root/name` for the newest store of that name.

    If the newest store is a segment of a recording, `root/name` opens all segments as one (`SegmentedStore`). Raises
    FileNotFoundError and `Damaged`. `core` tells whether to read with the native core, by default if it is installed.
    """
    from . import segments

    return segments.open_path(os.fspath(path), core)


class Store(FrameReader):
    """A recording. It can be read while it is being written; `refresh` reads new entries.

    Damaged parts are skipped if the rest is readable without them, and are listed in `damage`.
    """

    def __init__(self, path: str, core: Optional[bool] = None) -> None:
        self.path = path
        self._files: Any = open_files(path, core)
        self._catalog_count = -1
        self._index_streams()

    def __repr__(self) -> str:
        counts = f"{len(self._streams)} streams, {len(self.damage)} damaged"
        return f"<situ.Store {self.name!r} at {self.path!r}: {self.state}, {counts}>"

    def refresh(self) -> bool:
        """Reads newly committed messages. Returns whether there were any."""
        new: bool = self._files.refresh()
        if new:
            self._index_streams()
        return new

    def _index_streams(self) -> None:
        summaries = self._files.summarize_streams()
        self._read_catalog(summaries.get(0, (0,))[0])
        self._ids: dict[str, int] = {}
        self._streams: dict[str, Stream] = {}
        records = {id: self._records.get(id) for id in sorted({*self._records, *summaries} - {0})}
        for id, found in records.items():
            # The stream's catalog record may be damaged, but its messages are still readable.
            found = found or {"stream": {"name": f"stream {id}"}, "codecs": {}}
            name = found["stream"]["name"]
            count, first, last = summaries.get(id, (0, None, None))
            self._ids[name] = id
            self._streams[name] = Stream(
                name,
                found["stream"].get("type", ":any"),
                count,
                first,
                last,
                found.get("closed", {}).get("time"),
                self._decode_metadata(name, found.get("metadata")),
            )

    def _read_catalog(self, count: int) -> None:
        """Reads the catalog if it has more messages than before."""
        if count != self._catalog_count:
            self._catalog_count = count
            record, self._records = self._files.read_catalog()
            self.name: Any = record.get("name")
            self._segment: Optional[dict[str, Any]] = record.get("piece")

    def _decode_metadata(self, name: str, record: Any) -> Any:
        if record is None:
            return None
        try:
            return terms.decode_term(base64.b64decode(record["term"], validate=True))
        except (Damaged, binascii.Error, KeyError, TypeError, ValueError) as error:
            self._files.note_damage(f"the metadata of stream {name!r}: {error}")
            return None

    @property
    def segment(self) -> Optional[dict[str, Any]]:
        """The facts about a segment of a recording as a dict, or None if the store is not a segment."""
        return self._segment

    @property
    def streams(self) -> dict[str, Stream]:
        """A dict from name to `Stream`."""
        return dict(self._streams)

    @property
    def closed(self) -> bool:
        """Whether the writer has closed the store."""
        return bool(self._files.state == 1)

    @property
    def state(self) -> str:
        """"live" while it is being written, "closed", or "abandoned" if its writer exited without closing it."""
        return "closed" if self.closed else "abandoned" if self._files.is_abandoned() else "live"

    @property
    def created(self) -> int:
        """The store's creation time in nanoseconds."""
        created: int = self._files.created
        return created

    @property
    def damage(self) -> list[str]:
        """Descriptions of damaged parts that were skipped so far."""
        return list(self._files.damage)

    def read(
        self,
        name: str,
        start: Optional[int] = None,
        stop: Optional[int] = None,
        follow: bool = False,
        skip_damage: bool = False,
    ) -> Iterator[Message]:
        """Yields the messages of a stream from `start` to `stop` (nanoseconds, inclusive) in order of time.

        With `follow=True`, it waits for new messages until the writer closes the store. If the writer was killed, the
        iteration ends with an `AbandonedWarning`. A damaged chunk of messages raises `Damaged`; with
        `skip_damage=True`, it is skipped and listed in `damage`. An unknown stream raises KeyError.
        """
        id, position = self._find_id(name), None
        while True:
            # Read the state before the entries: once the store is closed, no more entries follow.
            closed = self.closed
            while (chunk := self._next_chunk(id, position, start)) is not None:
                if stop is not None and chunk.first > stop:
                    return
                yield from self._read_chunk(name, chunk, (start, stop), skip_damage)
                position = chunk.next
            if not follow or closed:
                return
            if not self._wait_for_change():
                return

    def _find_id(self, name: str) -> int:
        if name not in self._ids:
            raise KeyError(f"unknown stream {name!r}; the streams are {sorted(self._ids)}")
        return self._ids[name]

    def _read_table(
        self, name: str, start: Bound, stop: Bound, skip_damage: bool, report: Progress
    ) -> Optional[dict[str, Any]]:
        """Returns the columns of a stream of maps, or None if the messages have to be read one by one."""
        found = self._files.read_table(values.import_numpy(), self._find_id(name), start, stop, report)
        # A frame without rows or fields has a column `value`.
        if found is None or len(found[0]) == 1 or not len(found[0]["time"]):
            return None
        columns: dict[str, Any] = found[0]
        for position, error in found[1]:
            if not skip_damage:
                raise error
            self._files.note_damage(f"stream {name!r}, chunk {position}: {error}")
        return columns

    def _next_chunk(self, id: int, position: Optional[int], start: Bound) -> Optional[ChunkRange]:
        """Returns the chunk at a position or, without one, the first chunk that ends at or after `start`."""
        chunk: Optional[ChunkRange]
        if position is None and start is not None:
            chunk = self._files.find_chunk(id, start)
        else:
            chunk = self._files.get_chunk(id, position or 0)
        return chunk

    def _read_range(self, name: str, start: Bound, stop: Bound, skip_damage: bool) -> Iterator[Message]:
        """Yields the messages of a stream like `read`, but large ones as `Lazy`."""
        id = self._find_id(name)
        chunk = self._next_chunk(id, None, start)
        while chunk is not None and (stop is None or chunk.first <= stop):
            if chunk.large:
                yield Message(chunk.first, Lazy(self, name, chunk))
            else:
                yield from self._read_chunk(name, chunk, (start, stop), skip_damage)
            chunk = self._next_chunk(id, chunk.next, start)

    def _wait_for_change(self) -> bool:
        """Waits for new messages or the end. Returns False if no more messages can arrive."""
        while True:
            # Look at the lock before the entries: once it is free, no more entries follow.
            abandoned = self._files.is_abandoned()
            if self.refresh() or self.closed:
                return True
            if abandoned:
                warnings.warn(f"{self.path}: the writer exited without closing it", AbandonedWarning, stacklevel=3)
                return False
            clock.sleep(0.02)

    def _read_chunk(
        self, name: str, chunk: ChunkRange, range: tuple[Bound, Bound] = (None, None), skip_damage: bool = False
    ) -> Iterator[Message]:
        """Yields the messages of a chunk, up to the damage if it is damaged."""
        start, stop = range
        is_inside = (start is None or start <= chunk.first) and (stop is None or chunk.last <= stop)
        text = self._streams[name].type != ":binary"
        try:
            encoding, codec, rows = self._files.read_rows(self._ids[name], chunk, text)
            decode = self._find_decoder(name, encoding, codec)
            for time, creation, sequence, data in rows:
                if is_inside or ((start is None or time >= start) and (stop is None or time <= stop)):
                    yield Message(time, data if decode is None else decode(data), creation, sequence)
        except (Damaged, FileNotFoundError) as error:
            if not skip_damage:
                raise
            self._files.note_damage(f"stream {name!r}, chunk {chunk.position}: {error}")

    def _find_decoder(self, name: str, encoding: int, codec: int) -> Optional[Callable[[Any], Any]]:
        """Returns a function that decodes the payloads of an encoding, or None if they are values."""
        if encoding in (INTS, FLOATS, BOOLEANS, BINARIES):
            return None
        if encoding == TERMS:
            return terms.decode_term
        if encoding == CODEC:
            codecs = self._records.get(self._ids[name], {"codecs": {}})["codecs"]
            return functools.partial(values.decode_value, codecs.get(codec, "?"))
        raise Damaged(f"unknown encoding of messages: {encoding}")

    def array(
        self,
        name: str,
        start: Optional[int] = None,
        stop: Optional[int] = None,
        skip_damage: bool = False,
        progress: Optional[bool] = None,
    ) -> tuple[Any, Any]:
        """Returns the times (int64, ns) and values of a stream as two numpy arrays.

        The values are numbers, booleans or arrays of one shape: (messages,) or (messages, *shape). `start` and `stop`
        (ns) are inclusive. Numbers are not copied if the native core reads them. Raises KeyError, and `Damaged` in the
        same cases as `read`. `progress` tells whether to show progress, by default on a terminal and in notebooks.
        """
        np = values.import_numpy()
        id = self._find_id(name)
        times, data = [], []
        with Progress(f"Reading {name}", progress) as report:
            for done, found in self._files.read_arrays(np, id, start, stop):
                report(done)
                if found.error is not None:
                    if not skip_damage:
                        raise found.error
                    self._files.note_damage(f"stream {name!r}, chunk {found.chunk.position}: {found.error}")
                elif found.chunk is not None:
                    rows = list(self._read_chunk(name, found.chunk, (start, stop), skip_damage))
                    items = [row.data.array if hasattr(row.data, "array") else row.data for row in rows]
                    times.append(np.array([row.time for row in rows], "i8"))
                    data.append(np.array(items))
                elif found.times is not None:
                    times.append(found.times)
                    data.append(found.data)
        if len(times) == 1:
            return times[0], data[0]
        if not times:
            return np.array([], "i8"), np.array([])
        return np.concatenate(times), np.concatenate(data)
