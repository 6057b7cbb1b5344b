"""Reads the files of a store's folder: index, extents and chunks, as defined in `priv/schema/store.md`.

This second reader of the format was written from that page alone. Use `situ.open` to read a store.
"""

from __future__ import annotations

import bisect
import fcntl
import json
import os
import struct
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, Optional, Union

from . import columns
from .binary import (
    BINARIES,
    BOOLEANS,
    CODEC,
    DECOMPRESSORS,
    FLOATS,
    INTS,
    MASK,
    Buffer,
    Cursor,
    Damaged,
    crc32c,
    to_signed64,
    verify_checksum,
)

INDEX_HEADER, ENTRY = 4096, 64
DATA, LARGE = 0, 1
LANES = {DATA: "data", LARGE: "large"}
HEADERS = {b"CHNK": 96, b"CHK2": 112}
GAP = 255

_ENTRY = struct.Struct("<IIBBHIQIIQqqq")
_ENTRY_NAMES = "stream level lane zero extent offset length count ordinal first last creation".split()
_CHUNK = struct.Struct("<IIIBBBBIQqqQqQdIIHHI")
_CHUNK_NAMES = (
    "crc length stream level encoding compression zero count ordinal first last sequence creation size latency "
    "raw table codec zero2 body_crc"
).split()


_MAX_DAMAGE = 10_000
# Originating time, creation time (ns), sequence id, and data.
Row = tuple[int, int, int, Any]


class ChunkRange(NamedTuple):
    """A chunk of messages: its position in its stream, the times (ns) of its first and last message, and so on."""

    position: int
    first: int
    last: int
    next: int
    """The position of the next chunk."""
    large: bool
    """Whether it contains a single large message."""


class Found(NamedTuple):
    """A part of a stream that is read as arrays: `times` and `data`, or the `chunk` that these do not contain.

    The messages of this chunk are not plain numbers, or it is damaged, with `error`.
    """

    times: Any = None
    data: Any = None
    chunk: Optional[ChunkRange] = None
    error: Optional[Exception] = None


class DamageList:
    """Descriptions of damaged parts that were skipped, `damage`."""

    def __init__(self) -> None:
        self.damage: list[str] = []

    def note_damage(self, sentence: str) -> None:
        """Adds a description of damage, unless it was added already."""
        if len(self.damage) < _MAX_DAMAGE and sentence not in self.damage[-100:]:
            self.damage.append(sentence)


class StoreFiles(DamageList):
    """The files of a store: its committed index entries and their chunks. No file is kept open.

    Damaged parts are skipped, and described by sentences in `damage`. `situ.core.CoreFiles` does the same in native
    code.
    """

    def __init__(self, folder: str) -> None:
        super().__init__()
        self.folder = os.fspath(folder)
        self.entries: list[dict[str, Any]] = []
        self._chunks: dict[int, list[dict[str, Any]]] = {}
        self._entries_read, self._header_intact = 0, True
        self._last_times: dict[tuple[int, int], int] = {}
        self._checked_extents: set[tuple[int, int]] = set()
        self.refresh()

    def refresh(self) -> bool:
        """Reads newly committed entries. Returns whether there were any."""
        with open(os.path.join(self.folder, "index.situ"), "rb") as file:
            header = file.read(INDEX_HEADER)
            if len(header) < INDEX_HEADER or header[:8] != b"SITUIDX1":
                raise Damaged("index.situ is not an index; `situ store repair` rebuilds a lost index from the data")
            version, crc = struct.unpack_from("<II", header, 8)
            if version > 2:
                raise Damaged(f"the store has format version {version}; this reader supports versions up to 2")
            if self._header_intact and crc32c(header[16:64]) != crc:
                self._header_intact = False
                self.note_damage("the checksum of the index header does not match")
            self.id = header[16:32]
            (self.created,) = struct.unpack_from("<q", header, 32)
            self.committed, self.synced = struct.unpack_from("<QQ", header, 64)
            (self.state,) = struct.unpack_from("<I", header, 80)
            room = (os.fstat(file.fileno()).st_size - INDEX_HEADER) // ENTRY
            if self.committed > room:
                self.note_damage(f"index.situ ends before entry {self.committed}")
            before, known = len(self.entries), self._entries_read
            file.seek(INDEX_HEADER + ENTRY * known)
            rows = file.read(ENTRY * max(min(self.committed, room) - known, 0))
        for at in range(0, len(rows) // ENTRY * ENTRY, ENTRY):
            self._add_entry(rows[at : at + ENTRY], self._entries_read)
            self._entries_read += 1
        return len(self.entries) > before

    def _add_entry(self, raw: bytes, number: int) -> None:
        fields = _ENTRY.unpack(raw)
        if crc32c(raw[4:]) != fields[0]:
            return self.note_damage(f"the checksum of index entry {number} does not match")
        entry = dict(zip(_ENTRY_NAMES, fields[1:]), number=number)
        directory = (entry["stream"], entry["level"])
        if entry["level"] == GAP:
            return None
        if directory in self._last_times and entry["first"] <= self._last_times[directory]:
            return self.note_damage(f"index entry {number} is not later than the previous one")
        self._last_times[directory] = entry["last"]
        self.entries.append(entry)
        if entry["level"] == 0:
            self._chunks.setdefault(entry["stream"], []).append(entry)

    def is_abandoned(self) -> bool:
        """Returns whether the writer exited without closing the store, so that no process holds its lock."""
        if self.state == 1:
            return False
        try:
            with open(os.path.join(self.folder, "lock"), "rb") as lock:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            return not self._read_state()
        except FileNotFoundError:
            return True
        except OSError:
            # A writer holds the lock, or the lock cannot be tested.
            return False

    def _read_state(self) -> bool:
        """Returns the store's present state, which `state` is only after the next refresh."""
        with open(os.path.join(self.folder, "index.situ"), "rb") as file:
            return file.read(84)[80:] == b"\1\0\0\0"

    def _check_extent(self, lane: int, number: int) -> str:
        """Returns an extent's path. Checks its header the first time."""
        path = os.path.join(self.folder, f"{LANES[lane]}-{number:06}.situ")
        if (lane, number) not in self._checked_extents:
            with open(path, "rb") as file:
                head = file.read(64)
            if len(head) < 64 or head[:8] != b"SITUDAT1":
                raise Damaged(f"{path} is not an extent")
            _version, crc = struct.unpack_from("<II", head, 8)
            verify_checksum(crc, head[16:64], f"the header of {path}")
            has_store_id = not self._header_intact or head[16:32] == self.id
            if not has_store_id or struct.unpack_from("<II", head, 32) != (lane, number):
                raise Damaged(f"{path} belongs to a different store or extent")
            self._checked_extents.add((lane, number))
        return path

    def read_chunk(self, entry: dict[str, Any]) -> tuple[dict[str, Any], Buffer]:
        """Returns a chunk's header (a dict) and its decompressed body."""
        if entry["lane"] not in LANES:
            raise Damaged(f"an index entry has the unknown lane {entry['lane']}")
        with open(self._check_extent(entry["lane"], entry["extent"]), "rb") as file:
            file.seek(entry["offset"])
            raw = file.read(entry["length"])
        if entry["offset"] % 8 or raw[:4] not in HEADERS or len(raw) != entry["length"]:
            raise Damaged("there is no chunk at the offset in the index")
        begin = HEADERS[raw[:4]]
        if len(raw) < begin:
            raise Damaged("a chunk is shorter than its header")
        header = dict(zip(_CHUNK_NAMES, _CHUNK.unpack_from(raw, 4)))
        for key in ("length", "stream", "level", "count", "first", "last", "creation"):
            if header[key] != entry[key]:
                raise Damaged(f"the chunk and the index have different values of {key}")
        stored = raw[begin:]
        if begin == 112:
            number, committed = struct.unpack_from("<QQ", raw, 96)
            if number != entry["number"] or committed > number:
                raise Damaged("a chunk contains a different entry number than the index")
        covered = 0 if header["compression"] else header["table"]
        verify_checksum(header["crc"], raw[8:begin] + stored[:covered], "a chunk's header")
        verify_checksum(header["body_crc"], stored[covered:], "a chunk's body")
        body = DECOMPRESSORS[header["compression"]](stored, header["raw"])
        if len(body) != header["raw"]:
            raise Damaged("a chunk's decompressed length differs from its header")
        return header, body

    def read_messages(self, entry: dict[str, Any]) -> Iterator[dict[str, Any]]:
        """Yields the messages of a chunk as dicts (`time`, `creation`, `sequence`, `encoding`, `data` or `bytes`)."""
        yield from _iterate_messages(*self.read_chunk(entry))

    def summarize_streams(self) -> dict[int, tuple[int, int, int]]:
        """Returns a dict from stream number to (message count, first time, last time) of streams with messages."""
        return {
            id: (sum(entry["count"] for entry in chunks), chunks[0]["first"], chunks[-1]["last"])
            for id, chunks in self._chunks.items()
        }

    def get_chunk(self, id: int, position: int) -> Optional[ChunkRange]:
        """Returns the `ChunkRange` of a stream at a position, or None."""
        chunks = self._chunks.get(id, [])
        if position >= len(chunks):
            return None
        entry = chunks[position]
        return ChunkRange(position, entry["first"], entry["last"], position + 1, entry["lane"] == LARGE)

    def find_chunk(self, id: int, time: int) -> Optional[ChunkRange]:
        """Returns the first chunk of a stream that ends at or after a time, or None."""
        chunks = self._chunks.get(id, [])
        return self.get_chunk(id, bisect.bisect_left([entry["last"] for entry in chunks], time))

    def read_rows(self, id: int, chunk: ChunkRange, text: bool) -> tuple[int, int, Iterator[Row]]:
        """Returns the encoding of a chunk, its codec, and an iterator of (time, creation, sequence, data).

        The data are numbers, booleans, None or bytes; unencoded bytes in UTF-8 are str if `text`.
        """
        entry = self._chunks[id][chunk.position]
        header, body = self.read_chunk(entry)
        return header["encoding"], header["codec"], self._iterate_rows(header, body, text)

    def _iterate_rows(self, header: dict[str, Any], body: Buffer, text: bool) -> Iterator[Row]:
        for message in _iterate_messages(header, body):
            data = message["bytes"] if "bytes" in message else message["data"]
            if text and header["encoding"] == BINARIES:
                data = decode_text(data)
            yield message["time"], message["creation"], message["sequence"], data

    def read_arrays(self, np: Any, id: int, start: Optional[int], stop: Optional[int]) -> Iterator[tuple[float, Found]]:
        """Yields a stream as arrays of times (int64) and numbers: (the part that was read so far, `Found`)."""
        chunk = self.get_chunk(id, 0) if start is None else self.find_chunk(id, start)
        all = max(len(self._chunks.get(id, [])), 1)
        while chunk is not None and (stop is None or chunk.first <= stop):
            yield chunk.next / all, self._read_arrays_of_chunk(np, id, chunk, (start, stop))
            chunk = self.get_chunk(id, chunk.next)

    def read_table(self, *_: Any) -> None:
        """Returns None: only the native core reads whole tables."""

    def _read_arrays_of_chunk(
        self, np: Any, id: int, chunk: ChunkRange, range: tuple[Optional[int], Optional[int]]
    ) -> Found:
        try:
            found = columns.decode_chunk(np, *self.read_chunk(self._chunks[id][chunk.position]))
        except (Damaged, FileNotFoundError) as error:
            return Found(chunk=chunk, error=error)
        if found is None:
            return Found(chunk=chunk)
        times, data = found
        low = 0 if range[0] is None else np.searchsorted(times, range[0], "left")
        high = None if range[1] is None else np.searchsorted(times, range[1], "right")
        return Found(times[low:high], data[low:high])

    def read_catalog(self) -> Any:
        """Returns the store's record, and a dict from stream number to the stream's records."""
        return parse_catalog(
            message["bytes"] for entry in self._chunks.get(0, []) for message in self._read_catalog_messages(entry)
        )

    def _read_catalog_messages(self, entry: dict[str, Any]) -> Iterator[dict[str, Any]]:
        # Chunks after a damaged chunk of the catalog are still usable.
        try:
            yield from self.read_messages(entry)
        except Damaged as error:
            self.note_damage(f"the catalog, index entry {entry['number']}: {error}")


def _iterate_messages(header: dict[str, Any], body: Buffer) -> Iterator[dict[str, Any]]:
    table, payload = Cursor(body[: header["table"]]), Cursor(body, header["table"])
    encoding = header["encoding"]
    sequence = header["sequence"] - 1
    time = header["first"]
    latency = to_signed64(header["creation"] - header["first"])
    for _ in range(header["count"]):
        sequence = (sequence + table.read_zigzag() + 1) & MASK
        time = to_signed64(time + table.read_varint())
        latency = to_signed64(latency + table.read_zigzag())
        message = {"sequence": sequence, "time": time, "creation": to_signed64(time + latency)}
        if encoding == INTS:
            message["data"] = payload.read_zigzag()
        elif encoding == FLOATS:
            (message["data"],) = payload.read_struct("<d")
        elif encoding == BOOLEANS:
            message["data"] = {0: False, 1: True}.get(payload.read_bytes(1)[0])
        else:
            message["bytes"] = payload.read_bytes(table.read_varint())
        message["encoding"] = encoding
        if encoding == CODEC:
            message["codec"] = header["codec"]
        yield message
    if time != header["last"]:
        raise Damaged("the last message's time differs from the chunk header")


def decode_text(raw: Any) -> Union[str, bytes]:
    """Returns bytes as str if they are UTF-8."""
    try:
        return bytes(raw).decode()
    except UnicodeDecodeError:
        return bytes(raw)


def parse_catalog(texts: Iterable[Any]) -> tuple[dict[str, Any], dict[int, dict[str, Any]]]:
    """Returns the store's record, and a dict from stream number to the stream's records, from the catalog."""
    streams: dict[int, dict[str, Any]] = {}
    store: dict[str, Any] = {}
    piece: Optional[dict[str, Any]] = None
    for text in texts:
        try:
            record = json.loads(text)
            kind = record["kind"]
        except (ValueError, KeyError, TypeError):
            # An unreadable record does not affect the others.
            continue
        stream = streams.setdefault(record.get("id"), {"codecs": {}})
        if kind == "store":
            store = record
        elif kind == "piece":
            # Later records add facts.
            piece = {**(piece or {}), **{key: value for key, value in record.items() if value is not None}}
        elif kind == "codec":
            stream["codecs"][record["number"]] = record["name"]
        else:
            stream[kind] = record
    if piece is not None:
        store = {**store, "piece": piece}
    return store, {id: stream for id, stream in streams.items() if "stream" in stream}
