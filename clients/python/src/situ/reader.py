"""Reads stores: `situ.open("recordings/lobby")`."""

from __future__ import annotations

import base64
import binascii
import bisect
import dataclasses
import os
import time as clock
import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Optional, Union

from . import columns, terms, values
from .binary import Damaged
from .frames import FrameReader
from .layout import BINARIES, BOOLEANS, CODEC, FLOATS, INTS, TERMS, StoreFiles

if TYPE_CHECKING:
    from .segments import SegmentedStore

Path = Union[str, "os.PathLike[str]"]
AnyStore = Union["Store", "SegmentedStore"]


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


def open(path: Path) -> AnyStore:
    """Opens a store: `path` is its folder, or `root/name` for the newest store of that name.

    If the newest store is a segment of a recording, `root/name` opens all segments as one (`SegmentedStore`). Raises
    FileNotFoundError and `Damaged`.
    """
    from . import segments

    return segments.open_path(os.fspath(path))


class Store(FrameReader):
    """A recording. It can be read while it is being written; `refresh` reads new entries.

    Damaged parts are skipped if the rest is readable without them, and are listed in `damage`.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._files = StoreFiles(path)
        self._index_streams()

    def __repr__(self) -> str:
        counts = f"{len(self._streams)} streams, {len(self.damage)} damaged"
        return f"<situ.Store {self.name!r} at {self.path!r}: {self.state}, {counts}>"

    def refresh(self) -> bool:
        """Reads newly committed messages. Returns whether there were any."""
        new = self._files.refresh()
        if new:
            self._index_streams()
        return new

    def _index_streams(self):
        record, streams = self._files.read_catalog()
        self.name = record.get("name")
        self._segment = record.get("piece")
        self._ids, self._streams, self._records, self._entries = {}, {}, {}, {}
        for entry in self._files.entries:
            if entry["level"] == 0:
                self._entries.setdefault(entry["stream"], []).append(entry)
        for id in self._entries.keys() - streams.keys() - {0}:
            # The stream's catalog record is damaged, but its messages are still readable.
            streams[id] = {"stream": {"name": f"stream {id}"}, "codecs": {}}
        for id, found in sorted(streams.items()):
            name, entries = found["stream"]["name"], self._entries.get(id, [])
            self._ids[name], self._records[name] = id, found
            self._streams[name] = Stream(
                name,
                found["stream"].get("type", ":any"),
                sum(entry["count"] for entry in entries),
                entries[0]["first"] if entries else None,
                entries[-1]["last"] if entries else None,
                found.get("closed", {}).get("time"),
                self._decode_metadata(name, found.get("metadata")),
            )

    def _decode_metadata(self, name, record):
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
        return self._files.state == 1

    @property
    def state(self) -> str:
        """"live" while it is being written, "closed", or "abandoned" if its writer exited without closing it."""
        return "closed" if self.closed else "abandoned" if self._files.is_abandoned() else "live"

    @property
    def created(self) -> int:
        """The store's creation time in nanoseconds."""
        return self._files.created

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
        if name not in self._ids:
            raise KeyError(f"unknown stream {name!r}; the streams are {sorted(self._ids)}")
        done = 0
        while True:
            # Read the state before the entries: once the store is closed, no more entries follow.
            closed = self.closed
            entries = self._entries.get(self._ids[name], [])
            if done == 0 and start is not None:
                done = bisect.bisect_left([entry["last"] for entry in entries], start)
            while done < len(entries):
                entry = entries[done]
                if stop is not None and entry["first"] > stop:
                    return
                for message in self._read_messages(name, entry, skip_damage):
                    if (start is None or message.time >= start) and (stop is None or message.time <= stop):
                        yield message
                done += 1
            if not follow or closed:
                return
            if not self._wait_for_change():
                return

    def _wait_for_change(self):
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

    def _read_messages(self, name, entry, skip_damage):
        """Yields the messages of a chunk, up to the damage if it is damaged."""
        try:
            for message in self._files.read_messages(entry):
                yield self._build_message(name, message)
        except (Damaged, FileNotFoundError) as error:
            if not skip_damage:
                raise
            self._files.note_damage(f"stream {name!r}, index entry {entry['number']}: {error}")

    def _build_message(self, name, message):
        return Message(message["time"], self._decode_data(name, message), message["creation"], message["sequence"])

    def _decode_data(self, name, message):
        encoding = message["encoding"]
        if encoding in (INTS, FLOATS, BOOLEANS):
            return message["data"]
        if encoding == BINARIES:
            return self._decode_text(name, bytes(message["bytes"]))
        if encoding == TERMS:
            return terms.decode_term(message["bytes"])
        if encoding == CODEC:
            return values.decode_value(self._records[name]["codecs"].get(message["codec"], "?"), message["bytes"])
        raise Damaged(f"unknown encoding of messages: {encoding}")

    def _decode_text(self, name, raw):
        if self._streams[name].type == ":binary":
            return raw
        try:
            return raw.decode()
        except UnicodeDecodeError:
            return raw

    def array(
        self, name: str, start: Optional[int] = None, stop: Optional[int] = None, skip_damage: bool = False
    ) -> tuple[Any, Any]:
        """Returns the times (int64) and values of a stream as two numpy arrays.

        The values are numbers, booleans or arrays of one shape. `start` and `stop` (nanoseconds) are inclusive. Raises
        KeyError, and `Damaged` in the same cases as `read`.
        """
        np = values.import_numpy()
        if name not in self._ids:
            raise KeyError(f"unknown stream {name!r}; the streams are {sorted(self._ids)}")
        times, data = [], []
        for entry in self._entries.get(self._ids[name], []):
            if (start is None or entry["last"] >= start) and (stop is None or entry["first"] <= stop):
                found = self._read_columns(np, name, entry, skip_damage)
                low = 0 if start is None else np.searchsorted(found[0], start, "left")
                high = None if stop is None else np.searchsorted(found[0], stop, "right")
                times.append(found[0][low:high])
                data.append(found[1][low:high])
        if not times:
            return np.array([], "i8"), np.array([])
        return np.concatenate(times), np.concatenate(data)

    def _read_columns(self, np, name, entry, skip_damage):
        try:
            found = columns.decode_chunk(np, *self._files.read_chunk(entry))
        except (Damaged, FileNotFoundError) as error:
            if not skip_damage:
                raise
            self._files.note_damage(f"stream {name!r}, index entry {entry['number']}: {error}")
            return np.array([], "i8"), np.array([])
        if found is None:
            messages = list(self._read_messages(name, entry, skip_damage))
            data = [m.data.array if hasattr(m.data, "array") else m.data for m in messages]
            found = np.array([m.time for m in messages], "i8"), np.array(data)
        return found
