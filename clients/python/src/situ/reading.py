"""Stores as they are read: `situ.open("recordings/lobby")`."""

import bisect
import dataclasses
import os
import time as clock
from typing import Any

from . import terms, values
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
    """A recording. May be read while it is written; `refresh` takes in what is new."""

    def __init__(self, path):
        self.path = path
        self._files = Files(path)
        self._index()

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
        for id, found in sorted(streams.items()):
            name, entries = found["stream"]["name"], self._entries.get(id, [])
            self._ids[name], self._records[name] = id, found
            self._streams[name] = Stream(
                name,
                found["stream"].get("type", ":any"),
                entries[-1]["ordinal"] + entries[-1]["count"] if entries else 0,
                entries[0]["first"] if entries else None,
                entries[-1]["last"] if entries else None,
                found.get("closed", {}).get("time"),
            )

    @property
    def streams(self):
        """The streams by name."""
        return dict(self._streams)

    @property
    def closed(self):
        """Whether its writer closed it."""
        return self._files.state == 1

    def read(self, name, start=None, stop=None, follow=False):
        """The messages of a stream from `start` to `stop` (nanoseconds, both included), in order of time.

        With `follow` those that are still being written too, until the writer closes the store. Raises KeyError,
        `Damaged`.
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
                for message in self._files.messages(entry):
                    if (start is None or message["time"] >= start) and (stop is None or message["time"] <= stop):
                        yield self._message(name, message)
                done += 1
            if not follow or closed:
                return
            if not self.refresh() and not self.closed:
                clock.sleep(0.02)

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

    def array(self, name, start=None, stop=None):
        """Times (int64) and values of a stream of numbers, booleans or arrays of one shape, as two numpy arrays."""
        np = values.numpy()
        messages = list(self.read(name, start, stop))
        data = [m.data.array if hasattr(m.data, "array") else m.data for m in messages]
        return np.array([m.time for m in messages], "i8"), np.array(data)
