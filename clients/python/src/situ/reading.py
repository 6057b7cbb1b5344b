"""Stores as they are read: `situ.open("recordings/lobby")`."""

import base64
import binascii
import bisect
import dataclasses
import os
import time as clock
import warnings
from typing import Any

from . import columns, terms, values
from .bytes import Damaged
from .layout import BINARIES, BOOLEANS, CODEC, FLOATS, INTS, TERMS, Files


@dataclasses.dataclass
class Message:
    """Data and its times: when it happened, and when the message was made."""

    time: int
    data: Any
    creation: int = None
    sequence: int = None


@dataclasses.dataclass
class Stream:
    """One stream of a store."""

    name: str
    type: str
    count: int
    first: int = None
    last: int = None
    closed: int = None
    metadata: Any = None


class AbandonedWarning(UserWarning):
    """A store that is followed has lost its writer: it was killed, and nothing more will come."""


def open(path):
    """A store: its folder, or `root/name`, the newest of that name. Raises FileNotFoundError, `Damaged`."""
    path = os.fspath(path)
    if not os.path.exists(os.path.join(path, "index.situ")):
        path = _newest(path) or path
    return Store(path)


def _newest(path):
    root, name = os.path.split(path)
    root = root or "."
    if not os.path.isdir(root):
        return None
    numbers = [ending for full in os.listdir(root) if full[: len(name) + 1] == name + "." and (ending := full[len(name) + 1 :]).isdigit()]
    return os.path.join(root, f"{name}.{max(numbers, key=int)}") if numbers else None


class Store:
    """A recording. May be read while it is written; `refresh` takes in what is new.

    What is damaged is passed over where the rest can be read without it, and listed in `damage`.
    """

    def __init__(self, path):
        self.path = path
        self._files = Files(path)
        self._index()

    def __repr__(self):
        return f"<situ.Store {self.name!r} at {self.path!r}: {self.state}, {len(self._streams)} streams, {len(self.damage)} damaged>"

    def refresh(self):
        """Takes in what was committed since; True when there was something."""
        new = self._files.refresh()
        if new:
            self._index()
        return new

    def _index(self):
        record, streams = self._files.catalog()
        self.name = record.get("name")
        self._ids, self._streams, self._records, self._entries = {}, {}, {}, {}
        for entry in self._files.entries:
            if entry["level"] == 0:
                self._entries.setdefault(entry["stream"], []).append(entry)
        for id in self._entries.keys() - streams.keys() - {0}:
            # Its record in the catalog is damaged: the messages are still there.
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
                self._metadata(name, found.get("metadata")),
            )

    def _metadata(self, name, record):
        if record is None:
            return None
        try:
            return terms.decode(base64.b64decode(record["term"], validate=True))
        except (Damaged, binascii.Error, KeyError, TypeError, ValueError) as error:
            self._files.note(f"the metadata of {name}: {error}")
            return None

    @property
    def streams(self):
        """The streams by name."""
        return dict(self._streams)

    @property
    def closed(self):
        """Whether its writer closed it."""
        return self._files.state == 1

    @property
    def state(self):
        """"closed", "live" while somebody writes it, or "abandoned" where its writer ended without closing it."""
        return "closed" if self.closed else "abandoned" if self._files.abandoned() else "live"

    @property
    def created(self):
        """When it was made, in nanoseconds."""
        return self._files.created

    @property
    def damage(self):
        """Sentences about what is damaged and was passed over, as far as the store was read."""
        return list(self._files.damage)

    def read(self, name, start=None, stop=None, follow=False, skip_damage=False):
        """The messages of a stream from `start` to `stop` (nanoseconds, both included), in order of time.

        With `follow` those that are still being written too, until the writer closes the store. Where it was killed,
        that ends too, with an `AbandonedWarning`. A damaged chunk of messages raises `Damaged`; with `skip_damage` it is
        passed over and listed in `damage`. Raises KeyError.
        """
        if name not in self._ids:
            raise KeyError(f"no stream {name!r}; there are {sorted(self._ids)}")
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
                for message in self._messages(name, entry, skip_damage):
                    if (start is None or message.time >= start) and (stop is None or message.time <= stop):
                        yield message
                done += 1
            if not follow or closed:
                return
            if not self._await():
                return

    def _await(self):
        """Waits for something new; False where nothing more can come."""
        while True:
            # Look at the lock before the entries: once it is free, no more entries follow.
            abandoned = self._files.abandoned()
            if self.refresh() or self.closed:
                return True
            if abandoned:
                warnings.warn(f"{self.path}: its writer ended without closing it", AbandonedWarning, stacklevel=3)
                return False
            clock.sleep(0.02)

    def _messages(self, name, entry, skip_damage):
        """The messages of a chunk; of a damaged one, those before the damage."""
        try:
            for message in self._files.messages(entry):
                yield self._message(name, message)
        except (Damaged, FileNotFoundError) as error:
            if not skip_damage:
                raise
            self._files.note(f"{name}, entry {entry['number']} of the index: {error}")

    def _message(self, name, message):
        return Message(message["time"], self._data(name, message), message["creation"], message["sequence"])

    def _data(self, name, message):
        encoding = message["encoding"]
        if encoding in (INTS, FLOATS, BOOLEANS):
            return message["data"]
        if encoding == BINARIES:
            return self._text(name, bytes(message["bytes"]))
        if encoding == TERMS:
            return terms.decode(message["bytes"])
        if encoding == CODEC:
            return values.decode(self._records[name]["codecs"].get(message["codec"], "?"), message["bytes"])
        raise Damaged(f"messages of the encoding {encoding}")

    def _text(self, name, raw):
        if self._streams[name].type == ":binary":
            return raw
        try:
            return raw.decode()
        except UnicodeDecodeError:
            return raw

    def array(self, name, start=None, stop=None, skip_damage=False):
        """Times (int64) and values of a stream of numbers, booleans or arrays of one shape, as two numpy arrays.

        From `start` to `stop` (nanoseconds, both included). Raises KeyError, and `Damaged` as `read` does.
        """
        np = values.numpy()
        if name not in self._ids:
            raise KeyError(f"no stream {name!r}; there are {sorted(self._ids)}")
        times, data = [], []
        for entry in self._entries.get(self._ids[name], []):
            if (start is None or entry["last"] >= start) and (stop is None or entry["first"] <= stop):
                found = self._arrays(np, name, entry, skip_damage)
                low = 0 if start is None else np.searchsorted(found[0], start, "left")
                high = None if stop is None else np.searchsorted(found[0], stop, "right")
                times.append(found[0][low:high])
                data.append(found[1][low:high])
        if not times:
            return np.array([], "i8"), np.array([])
        return np.concatenate(times), np.concatenate(data)

    def _arrays(self, np, name, entry, skip_damage):
        try:
            found = columns.decode(np, *self._files.chunk(entry))
        except (Damaged, FileNotFoundError) as error:
            if not skip_damage:
                raise
            self._files.note(f"{name}, entry {entry['number']} of the index: {error}")
            return np.array([], "i8"), np.array([])
        if found is None:
            messages = list(self._messages(name, entry, skip_damage))
            data = [m.data.array if hasattr(m.data, "array") else m.data for m in messages]
            found = np.array([m.time for m in messages], "i8"), np.array(data)
        return found
