"""Reads the files of a store's folder: index, extents and chunks, as defined in `priv/schema/store.md`.

This second reader of the format was written from that page alone. Use `situ.open` to read a store.
"""

import fcntl
import json
import os
import struct

from .binary import DECOMPRESSORS, MASK, Cursor, Damaged, crc32c, to_signed64, verify_checksum

INDEX_HEADER, ENTRY = 4096, 64
DATA, LARGE = 0, 1
LANES = {DATA: "data", LARGE: "large"}
HEADERS = {b"CHNK": 96, b"CHK2": 112}
BINS, INTS, FLOATS, BINARIES, TERMS, CODEC, BOOLEANS, TRACKS = range(8)
GAP = 255

_ENTRY = struct.Struct("<IIBBHIQIIQqqq")
_ENTRY_NAMES = "stream level lane zero extent offset length count ordinal first last creation".split()
_CHUNK = struct.Struct("<IIIBBBBIQqqQqQdIIHHI")
_CHUNK_NAMES = (
    "crc length stream level encoding compression zero count ordinal first last sequence creation size latency "
    "raw table codec zero2 body_crc"
).split()


_MAX_DAMAGE = 10_000


class StoreFiles:
    """The files of a store: its committed index entries and their chunks. No file is kept open.

    Damaged parts are skipped, and described by sentences in `damage`.
    """

    def __init__(self, folder):
        self.folder = os.fspath(folder)
        self.entries = []
        self.damage = []
        self._entries_read, self._header_intact, self._last_times = 0, True, {}
        self._checked_extents = set()
        self.refresh()

    def refresh(self):
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

    def _add_entry(self, raw, number):
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

    def note_damage(self, sentence):
        """Adds a description of damage, unless it was added already."""
        if len(self.damage) < _MAX_DAMAGE and sentence not in self.damage[-100:]:
            self.damage.append(sentence)

    def is_abandoned(self):
        """Returns whether the writer exited without closing the store, so that no process holds its lock."""
        if self.state == 1:
            return False
        try:
            with open(os.path.join(self.folder, "lock"), "rb") as lock:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
                return True
        except FileNotFoundError:
            return True
        except OSError:
            # A writer holds the lock, or the lock cannot be tested.
            return False

    def _check_extent(self, lane, number):
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

    def read_chunk(self, entry):
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

    def read_messages(self, entry):
        """Yields the messages of a chunk as dicts (`time`, `creation`, `sequence`, `encoding`, `data` or `bytes`)."""
        header, body = self.read_chunk(entry)
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

    def read_catalog(self):
        """Returns the store's record, and a dict from stream number to the stream's records."""
        streams, store, piece = {}, {}, None
        for entry in self.find_entries(0, 0):
            for message in self._read_catalog_messages(entry):
                try:
                    record = json.loads(message["bytes"])
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

    def _read_catalog_messages(self, entry):
        # Chunks after a damaged chunk of the catalog are still usable.
        try:
            yield from self.read_messages(entry)
        except Damaged as error:
            self.note_damage(f"the catalog, index entry {entry['number']}: {error}")

    def find_entries(self, stream, level):
        """Returns the entries of a stream and level in order of time."""
        return [e for e in self.entries if e["stream"] == stream and e["level"] == level]
