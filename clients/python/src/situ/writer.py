"""Writes stores: `situ.create("lobby", "recordings")`."""

from __future__ import annotations

import fcntl
import json
import operator
import os
import re
import struct
from typing import Any, Optional

from . import binary, core, layout, terms, values
from .binary import crc32c, encode_varint, encode_zigzag
from .reader import Path
from .times import now
from .values import import_numpy

_BATCH, _BATCH_BYTES, _LARGE = 1_024, 65_536, 32_768
_MOST_WAITING = 100_000_000
_FIRST_EXTENT, _MAX_EXTENT = 4 << 20, 256 << 20
_HEAD = struct.Struct("<IIBBBBIQqqQqQdIIHHIQQ")


def create(name: str, root: Path = ".", core: Optional[bool] = None) -> Writer:
    """Creates a store in the folder `root/NAME.NNNN` and returns its `Writer`.

    Close the writer, or use it in a `with` statement. `core` tells whether to write with the native core, by default
    if it is installed.
    """
    kind = _find_class(core)
    if not re.fullmatch(r"[^/\x00-\x1f]+", name):
        raise ValueError(f"invalid store name {name!r}: it must be non-empty, without / and control characters")
    os.makedirs(root, exist_ok=True)
    matches = map(re.compile(re.escape(name) + r"\.(\d+)").fullmatch, os.listdir(root))
    number = max((int(match.group(1)) for match in matches if match), default=-1) + 1
    while True:
        path = os.path.join(root, f"{name}.{number:04}")
        try:
            os.mkdir(path)
            return kind(name, path)
        except FileExistsError:
            number += 1


def _find_class(use: Optional[bool]) -> type[Writer]:
    if not core.select_core(use):
        return Writer
    from .core_writer import CoreWriter

    return CoreWriter


def _check_time(time: Any) -> int:
    number: int = operator.index(time)
    if not -(1 << 63) <= number < 1 << 63:
        raise ValueError(f"time {time} is out of range: a store holds 64-bit nanoseconds, from 1677 to 2262")
    return number


class Writer:
    """Writes messages to streams. Committed messages are visible to readers and survive a kill of this process.

    Messages are committed by `commit` and `close`, when 1,024 messages or 64 KB of a stream are waiting, and by the
    first `write` that comes 0.1 s after the last commit.
    """

    def __init__(self, name: str, path: str) -> None:
        self.name, self.path = name, path
        self._streams: dict[str, Any] = {}
        self._open_files()
        self._add_record({"kind": "store", "name": name, "writer": "python", "volatile": False})
        self.commit()

    def _open_files(self) -> None:
        path = self.path
        self._id, self._entries, self._closed = os.urandom(16), 0, False
        self._lanes: dict[int, list[_PreallocatedFile]] = {}
        self._lock = os.open(os.path.join(path, "lock"), os.O_RDWR | os.O_CREAT, 0o644)
        fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._index = _PreallocatedFile(os.path.join(path, "index.situ"), 1 << 20)
        head = self._id + struct.pack("<q24x", now())
        self._index.write(0, b"SITUIDX1" + struct.pack("<II", 2, crc32c(head)) + head)
        self._index.set_end(layout.INDEX_HEADER)
        self._catalog = _PendingStream(0)
        self._catalog_time = 0

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, name: str, time: int, data: Any, creation: Optional[int] = None) -> None:
        """Appends a message to a stream, which is opened by its first message.

        `time` is an int in nanoseconds. It must be later than the stream's last message, or ValueError is raised.
        `data` is a number, str, bytes, None, list, tuple, dict, array, or an object of this package's classes. Other
        types raise TypeError.
        """
        if self._closed:
            raise ValueError("the writer is closed")
        time, present = _check_time(time), now()
        creation = max(present, time) if creation is None else _check_time(creation)
        stream = self._streams.get(name) or self._open_stream(name, data)
        if present - self._committed > _MOST_WAITING:
            self.commit()
        if stream.last is not None and time <= stream.last:
            raise ValueError(f"stream {name!r}: time {time} is not later than the previous message ({stream.last})")
        kind, payload = self._encode_data(stream, values.to_writable(data))
        if kind != stream.kind or len(payload) >= _LARGE or stream.is_full():
            self._flush_stream(stream)
        stream.add_message(kind, time, creation, payload)
        if len(payload) >= _LARGE:
            self._flush_stream(stream)

    def write_array(self, name: str, times: Any, values: Any, creations: Any = None) -> None:
        """Appends many messages to a stream and commits them. It needs numpy, and is fast with the native core.

        `times` are integers (ns) of shape (n,), increasing; or datetime64. `values` are booleans or numbers of shape
        (n,), or arrays of shape (n, ...), each of which is written as a tensor. Integers are written as int64 and
        floats as float64. Without `creations`, the creation times are the times. Raises ValueError and TypeError; the
        messages before an error are written.
        """
        np = import_numpy()
        times, values = _to_times(np, times), np.asarray(values)
        creations = times if creations is None else _to_times(np, creations)
        if times.ndim != 1 or times.shape != creations.shape or values.shape[:1] != times.shape:
            shapes = f"{times.shape}, {creations.shape} and {values.shape}"
            raise ValueError(f"the times, creation times and values have the shapes {shapes}, but need as many rows")
        if len(times):
            self._write_columns(name, times, values, creations)
        self.commit()

    def _write_columns(self, name: str, times: Any, values: Any, creations: Any) -> None:
        rows = values.tolist() if values.ndim == 1 else values
        for time, creation, value in zip(times.tolist(), creations.tolist(), rows):
            self.write(name, time, value, creation)

    def open(self, name: str, type: str) -> None:
        """Opens a stream with a type in Elixir's notation (`":float"`, `"Situ.Image"`).

        Without this call, the first message determines the type.
        """
        self._add_stream(name, type)

    def _add_stream(self, name: str, type: str) -> Any:
        if name in self._streams:
            raise ValueError(f"the store already has a stream {name!r}")
        stream = self._streams[name] = self._build_stream()
        record = {"kind": "stream", "id": stream.id, "name": name, "type": type, "opened": now()}
        self._add_record({**record, "large": False, "compression": "none"})
        return stream

    def _build_stream(self) -> Any:
        return _PendingStream(len(self._streams) + 1)

    def _open_stream(self, name: str, data: Any) -> Any:
        data = values.to_writable(data)
        codec = values.find_codec(data)
        kinds = {bool: ":boolean", int: ":integer", float: ":float", str: ":string", bytes: ":binary"}
        if not codec and type(data) not in kinds:
            terms.encode_term(data)  # Fails before the stream is opened if the value cannot be written.
        return self._add_stream(name, codec.TYPE if codec else kinds.get(type(data), ":any"))

    def _number_codec(self, stream: Any, codec: Any) -> int:
        """Returns the number of a codec, which is recorded with the first message that needs it."""
        if codec.NAME not in stream.codecs:
            stream.codecs[codec.NAME] = len(stream.codecs) + 1
            record = {"kind": "codec", "id": stream.id, "number": stream.codecs[codec.NAME], "name": codec.NAME}
            self._add_record({**record, "module": "Elixir." + codec.TYPE})
        number: int = stream.codecs[codec.NAME]
        return number

    def _encode_data(self, stream: Any, data: Any) -> tuple[tuple[int, int], bytes]:
        codec = values.find_codec(data)
        if codec:
            return (binary.CODEC, self._number_codec(stream, codec)), data.encode()
        if isinstance(data, bool) or data is None:
            return (binary.BOOLEANS, 0), bytes([2 if data is None else data])
        if type(data) is int and -(1 << 63) <= data < 1 << 63:
            return (binary.INTS, 0), encode_varint(encode_zigzag(data))
        if type(data) is float and data - data == 0:
            return (binary.FLOATS, 0), struct.pack("<d", data)
        if isinstance(data, (bytes, str)) and not isinstance(data, terms.Atom):
            return (binary.BINARIES, 0), data.encode() if isinstance(data, str) else data
        return (binary.TERMS, 0), terms.encode_term(data)

    def _add_record(self, record: dict[str, Any]) -> None:
        # The times of catalog records only have to increase.
        self._catalog_time = max(now(), self._catalog_time + 1)
        time, payload = self._catalog_time, json.dumps(record).encode()
        self._catalog.add_message((binary.BINARIES, 0), time, time, payload)

    def commit(self) -> None:
        """Writes pending messages, so that readers see them and a kill of this process cannot lose them."""
        for stream in self._streams.values():
            self._flush_stream(stream)
        self._flush_stream(self._catalog)
        self._committed = now()

    def _flush_stream(self, stream: _PendingStream) -> None:
        if not stream.rows:
            return
        # The records of a stream and its codecs must precede its messages.
        if stream is not self._catalog:
            self._flush_stream(self._catalog)
        (encoding, codec), rows = stream.kind, stream.rows
        lane = layout.LARGE if len(rows) == 1 and len(rows[0][2]) >= _LARGE else layout.DATA
        table, body = stream.encode_table(encoding), b"".join(payload for _, _, payload in rows)
        length = 112 + len(table) + len(body) + (64 if lane == layout.LARGE else 0)
        extent, offset = self._find_room(lane, length)
        if lane == layout.LARGE:
            table += bytes(-(offset + 112 + len(table)) % 64)
        length = 112 + len(table) + len(body)
        (first, created), last = rows[0][:2], rows[-1][0]
        latency = stream.latency + float(sum(creation - time for time, creation, _ in rows))
        size = stream.size + len(body)
        head = _HEAD.pack(
            length, stream.id, 0, encoding, 0, 0, len(rows), stream.count, first, last, stream.count + 1, created,
            size, latency, len(table) + len(body), len(table), codec, 0, crc32c(body), self._entries, self._entries,
        )  # fmt: skip
        extent.write(offset, b"CHK2" + struct.pack("<I", crc32c(head + table)) + head + table + body)
        extent.set_end(offset + length)
        entry = struct.pack(
            "<IBBHIQIIQqqq", stream.id, 0, lane, 0, extent.number, offset, length, len(rows), stream.count, first, last,
            created,
        )  # fmt: skip
        at = layout.INDEX_HEADER + layout.ENTRY * self._entries
        self._index.write(at, struct.pack("<I", crc32c(entry)) + entry)
        self._index.set_end(at + layout.ENTRY)
        self._entries += 1
        # Writing this word commits the entry.
        self._index.write(64, struct.pack("<Q", self._entries))
        stream.finish_flush(size, latency)

    def _find_room(self, lane: int, length: int) -> tuple[_PreallocatedFile, int]:
        extents = self._lanes.setdefault(lane, [])
        if not extents or -(-extents[-1].end // 8) * 8 + length > extents[-1].size:
            size = min(_FIRST_EXTENT * 4 ** len(extents), _MAX_EXTENT)
            if extents:
                extents[-1].close_file()
            path = os.path.join(self.path, f"{layout.LANES[lane]}-{len(extents):06}.situ")
            extent = _PreallocatedFile(path, max(size, -(-(length + 128) // 4096) * 4096))
            extent.number = len(extents)
            head = self._id + struct.pack("<II24x", lane, extent.number)
            extent.write(0, b"SITUDAT1" + struct.pack("<II", 2, crc32c(head)) + head)
            extent.set_end(64)
            extents.append(extent)
        return extents[-1], -(-extents[-1].end // 8) * 8

    def close(self) -> None:
        """Commits all messages and closes the store."""
        if self._closed:
            return
        self.commit()
        for stream in self._streams.values():
            if stream.last is not None:
                self._add_record({"kind": "closed", "id": stream.id, "time": stream.last})
        self._flush_stream(self._catalog)
        self._add_record({"kind": "end"})
        self._flush_stream(self._catalog)
        for extents in self._lanes.values():
            extents[-1].truncate_and_close()
        self._index.write(72, struct.pack("<Q", self._entries))
        self._index.write(80, struct.pack("<I", 1))
        self._index.truncate_and_close()
        self._closed = True
        os.close(self._lock)


def _to_times(np: Any, times: Any) -> Any:
    times = np.asarray(times)
    if times.dtype.kind == "M":
        return times.astype("M8[ns]").view("i8")
    if times.dtype.kind not in "iu":
        raise TypeError(f"times are integers (ns) or datetime64, not {times.dtype}")
    return times.astype("i8", copy=False)


class _PendingStream:
    """The messages of a stream that are not written yet, and the stream's running totals."""

    def __init__(self, id: int) -> None:
        self.id, self.kind = id, (0, 0)
        self.rows: list[tuple[int, int, bytes]] = []
        self.codecs: dict[str, int] = {}
        self.count, self.size, self.latency, self.bytes = 0, 0, 0.0, 0
        self.last: Optional[int] = None

    def is_full(self) -> bool:
        return len(self.rows) >= _BATCH or self.bytes >= _BATCH_BYTES

    def add_message(self, kind: tuple[int, int], time: int, creation: int, payload: bytes) -> None:
        self.kind, self.last = kind, time
        self.rows.append((time, creation, payload))
        self.bytes += len(payload)

    def encode_table(self, encoding: int) -> bytes:
        out, before = bytearray(), (self.rows[0][0], self.rows[0][1] - self.rows[0][0])
        for time, creation, payload in self.rows:
            out += b"\0" + encode_varint(time - before[0]) + encode_varint(encode_zigzag(creation - time - before[1]))
            if encoding in (binary.BINARIES, binary.TERMS, binary.CODEC):
                out += encode_varint(len(payload))
            before = (time, creation - time)
        return bytes(out)

    def finish_flush(self, size: int, latency: float) -> None:
        self.count += len(self.rows)
        self.size, self.latency, self.rows, self.bytes = size, latency, [], 0


class _PreallocatedFile:
    """A file that is allocated in advance (never sparse) and truncated when it is closed."""

    def __init__(self, path: str, step: int) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
        self._step, self.size, self.end, self.number = step, 0, 0, 0
        self._grow_to(step)

    def _grow_to(self, to: int) -> None:
        os.posix_fallocate(self._file, 0, to)
        self.size = to

    def write(self, at: int, data: bytes) -> None:
        while at + len(data) > self.size:
            self._grow_to(self.size + self._step)
        view = memoryview(data)
        while view:
            done = os.pwrite(self._file, view, at)
            view, at = view[done:], at + done

    def set_end(self, end: int) -> None:
        self.end = end

    def truncate_and_close(self) -> None:
        os.ftruncate(self._file, -(-self.end // 4096) * 4096)
        os.fsync(self._file)
        self.close_file()

    def close_file(self) -> None:
        os.close(self._file)
