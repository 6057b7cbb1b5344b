"""Stores as they are written: `situ.create("lobby", "recordings")`."""

import fcntl
import json
import operator
import os
import re
import struct

from . import layout, terms, values
from .bytes import crc32c, varint, zigzag
from .times import now

_BATCH, _BATCH_BYTES, _LARGE = 1_024, 65_536, 32_768
_FIRST_EXTENT, _MOST_EXTENT = 4 << 20, 256 << 20
_HEAD = struct.Struct("<IIBBBBIQqqQqQdIIHHIQQ")


def create(name, root="."):
    """A new store in the folder `root/NAME.NNNN`, open for writing; close it, or use it by `with`."""
    if not re.fullmatch(r"[^/\x00-\x1f]+", name):
        raise ValueError(f"{name!r} is no name for a store")
    os.makedirs(root, exist_ok=True)
    numbers = [int(found.group(1)) for found in map(re.compile(re.escape(name) + r"\.(\d+)").fullmatch, os.listdir(root)) if found]
    number = max(numbers, default=-1) + 1
    while True:
        path = os.path.join(root, f"{name}.{number:04}")
        try:
            os.mkdir(path)
            return Writer(name, path)
        except FileExistsError:
            number += 1


def _time(time):
    time = operator.index(time)
    if not -(1 << 63) <= time < 1 << 63:
        raise ValueError(f"{time} ns is no time that a store holds: it ends in 2262")
    return time


class Writer:
    """Writes messages to streams. Those that `commit` has written are visible to readers and survive a kill."""

    def __init__(self, name, path):
        self.name, self.path = name, path
        self._id, self._entries, self._streams, self._lanes = os.urandom(16), 0, {}, {}
        self._lock = os.open(os.path.join(path, "lock"), os.O_RDWR | os.O_CREAT, 0o644)
        fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._index = _File(os.path.join(path, "index.situ"), 1 << 20)
        head = self._id + struct.pack("<q24x", now())
        self._index.write(0, b"SITUIDX1" + struct.pack("<II", 2, crc32c(head)) + head)
        self._index.place(layout.INDEX_HEADER)
        self._catalog = _Pending(0)
        self._told = 0
        self._record({"kind": "store", "name": name, "writer": "python", "volatile": False})
        self.commit()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def write(self, name, time, data, creation=None):
        """Appends a message. Its time, nanoseconds as an int, must be later than the stream's last one (ValueError). Data
        are numbers, text, bytes, None, lists, tuples, dicts, arrays, and the classes of this package (TypeError for
        others)."""
        time = _time(time)
        creation = max(now(), time) if creation is None else _time(creation)
        stream = self._streams.get(name) or self._open(name, data)
        if stream.last is not None and time <= stream.last:
            raise ValueError(f"{name}: {time} is not later than the message before, {stream.last}")
        kind, payload = self._encode(stream, values.coded(data))
        if kind != stream.kind or len(payload) >= _LARGE or stream.full():
            self._flush(stream)
        stream.add(kind, time, creation, payload)
        if len(payload) >= _LARGE:
            self._flush(stream)

    def open(self, name, type):
        """Declares a stream by a type as Elixir writes it (`":float"`, `"Situ.Image"`); else its first message does."""
        if name in self._streams:
            raise ValueError(f"the stream {name!r} is there already")
        stream = self._streams[name] = _Pending(len(self._streams) + 1)
        record = {"kind": "stream", "id": stream.id, "name": name, "type": type, "opened": now()}
        self._record({**record, "large": False, "compression": "none"})
        return stream

    def _open(self, name, data):
        data = values.coded(data)
        codec = values.codec(data)
        kinds = {bool: ":boolean", int: ":integer", float: ":float", str: ":string", bytes: ":binary"}
        if not codec and type(data) not in kinds:
            terms.encode(data)  # one that cannot be written opens no stream
        return self.open(name, codec.TYPE if codec else kinds.get(type(data), ":any"))

    def _encode(self, stream, data):
        codec = values.codec(data)
        if codec:
            if codec.NAME not in stream.codecs:
                stream.codecs[codec.NAME] = len(stream.codecs) + 1
                record = {"kind": "codec", "id": stream.id, "number": stream.codecs[codec.NAME], "name": codec.NAME}
                self._record({**record, "module": "Elixir." + codec.TYPE})
            return (layout.CODEC, stream.codecs[codec.NAME]), data.encode()
        if isinstance(data, bool) or data is None:
            return (layout.BOOLEANS, 0), bytes([2 if data is None else data])
        if type(data) is int and -(1 << 63) <= data < 1 << 63:
            return (layout.INTS, 0), varint(zigzag(data))
        if type(data) is float and data - data == 0:
            return (layout.FLOATS, 0), struct.pack("<d", data)
        if isinstance(data, (bytes, str)) and not isinstance(data, terms.Atom):
            return (layout.BINARIES, 0), data.encode() if isinstance(data, str) else data
        return (layout.TERMS, 0), terms.encode(data)

    def _record(self, record):
        # The catalog's own times only have to increase.
        self._told = max(now(), self._told + 1)
        self._catalog.add((layout.BINARIES, 0), self._told, self._told, json.dumps(record).encode())

    def commit(self):
        """Writes what is pending, so that readers see it and nothing of it can be lost with this process."""
        for stream in self._streams.values():
            self._flush(stream)
        self._flush(self._catalog)

    def _flush(self, stream):
        if not stream.rows:
            return
        # A stream and its codecs are told of before its messages.
        if stream is not self._catalog:
            self._flush(self._catalog)
        (encoding, codec), rows = stream.kind, stream.rows
        lane = layout.LARGE if len(rows) == 1 and len(rows[0][2]) >= _LARGE else layout.DATA
        table, body = stream.table(encoding), b"".join(payload for _, _, payload in rows)
        length = 112 + len(table) + len(body) + (64 if lane == layout.LARGE else 0)
        extent, offset = self._lane(lane, length)
        if lane == layout.LARGE:
            table += bytes(-(offset + 112 + len(table)) % 64)
        length = 112 + len(table) + len(body)
        first, created = rows[0][:2]
        latency = stream.latency + float(sum(creation - time for time, creation, _ in rows))
        size = stream.size + len(body)
        head = _HEAD.pack(
            length, stream.id, 0, encoding, 0, 0, len(rows), stream.count, first, rows[-1][0], stream.count + 1, created,
            size, latency, len(table) + len(body), len(table), codec, 0, crc32c(body), self._entries, self._entries,
        )  # fmt: skip
        extent.write(offset, b"CHK2" + struct.pack("<I", crc32c(head + table)) + head + table + body)
        extent.place(offset + length)
        entry = struct.pack(
            "<IBBHIQIIQqqq", stream.id, 0, lane, 0, extent.number, offset, length, len(rows), stream.count, first, rows[-1][0], created
        )
        at = layout.INDEX_HEADER + layout.ENTRY * self._entries
        self._index.write(at, struct.pack("<I", crc32c(entry)) + entry)
        self._index.place(at + layout.ENTRY)
        self._entries += 1
        # One word commits.
        self._index.write(64, struct.pack("<Q", self._entries))
        stream.flushed(size, latency)

    def _lane(self, lane, length):
        extents = self._lanes.setdefault(lane, [])
        if not extents or -(-extents[-1].end // 8) * 8 + length > extents[-1].size:
            size = min(_FIRST_EXTENT * 4 ** len(extents), _MOST_EXTENT)
            if extents:
                extents[-1].release()
            path = os.path.join(self.path, f"{layout.LANES[lane]}-{len(extents):06}.situ")
            extent = _File(path, max(size, -(-(length + 128) // 4096) * 4096))
            extent.number = len(extents)
            head = self._id + struct.pack("<II24x", lane, extent.number)
            extent.write(0, b"SITUDAT1" + struct.pack("<II", 2, crc32c(head)) + head)
            extent.place(64)
            extents.append(extent)
        return extents[-1], -(-extents[-1].end // 8) * 8

    def close(self):
        """Commits everything and closes the store."""
        if self._index is None:
            return
        self.commit()
        for stream in self._streams.values():
            if stream.last is not None:
                self._record({"kind": "closed", "id": stream.id, "time": stream.last})
        self._flush(self._catalog)
        self._record({"kind": "end"})
        self._flush(self._catalog)
        for extents in self._lanes.values():
            extents[-1].cut()
        self._index.write(72, struct.pack("<Q", self._entries))
        self._index.write(80, struct.pack("<I", 1))
        self._index.cut()
        self._index = None
        os.close(self._lock)


class _Pending:
    """One stream's messages that are not written yet, and what its chunks count."""

    def __init__(self, id):
        self.id, self.kind, self.rows, self.codecs = id, None, [], {}
        self.count, self.size, self.latency, self.last, self.bytes = 0, 0, 0.0, None, 0

    def full(self):
        return len(self.rows) >= _BATCH or self.bytes >= _BATCH_BYTES

    def add(self, kind, time, creation, payload):
        self.kind, self.last = kind, time
        self.rows.append((time, creation, payload))
        self.bytes += len(payload)

    def table(self, encoding):
        out, before = bytearray(), (self.rows[0][0], self.rows[0][1] - self.rows[0][0])
        for time, creation, payload in self.rows:
            out += b"\0" + varint(time - before[0]) + varint(zigzag(creation - time - before[1]))
            if encoding in (layout.BINARIES, layout.TERMS, layout.CODEC):
                out += varint(len(payload))
            before = (time, creation - time)
        return bytes(out)

    def flushed(self, size, latency):
        self.count += len(self.rows)
        self.size, self.latency, self.rows, self.bytes = size, latency, [], 0


class _File:
    """A file that is allocated ahead, never sparse, and cut at the end."""

    def __init__(self, path, step):
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
        self._step, self.size, self.end = step, 0, 0
        self._grow(step)

    def _grow(self, to):
        os.posix_fallocate(self._file, 0, to)
        self.size = to

    def write(self, at, data):
        while at + len(data) > self.size:
            self._grow(self.size + self._step)
        view = memoryview(data)
        while view:
            done = os.pwrite(self._file, view, at)
            view, at = view[done:], at + done

    def place(self, end):
        self.end = end

    def cut(self):
        os.ftruncate(self._file, -(-self.end // 4096) * 4096)
        os.fsync(self._file)
        self.release()

    def release(self):
        os.close(self._file)
