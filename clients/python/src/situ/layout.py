"""The bytes of a store's folder, as `priv/schema/store.md` has them: index, extents, chunks.

A second reader of the format, written from that page alone. `situ.open` is what you want to read a store with.
"""

import fcntl
import json
import os
import struct

from .bytes import MASK, UNPACK, Cursor, Damaged, check, crc32c, signed

INDEX_HEADER, ENTRY = 4096, 64
DATA, LARGE = 0, 1
LANES = {DATA: "data", LARGE: "large"}
HEADERS = {b"CHNK": 96, b"CHK2": 112}
BINS, INTS, FLOATS, BINARIES, TERMS, CODEC, BOOLEANS, TRACKS = range(8)
HOLE = 255

_ENTRY = struct.Struct("<IIBBHIQIIQqqq")
_ENTRY_NAMES = "stream level lane zero extent offset length count ordinal first last creation".split()
_CHUNK = struct.Struct("<IIIBBBBIQqqQqQdIIHHI")
_CHUNK_NAMES = (
    "crc length stream level encoding compression zero count ordinal first last sequence creation size latency "
    "raw table codec zero2 body_crc"
).split()


_MOST_DAMAGE = 10_000


class Files:
    """A store's files: its committed entries, and chunks by them. Nothing is kept open.

    What is damaged is passed over, and listed as sentences in `damage`.
    """

    def __init__(self, folder):
        self.folder = os.fspath(folder)
        self.entries = []
        self.damage = []
        self._known, self._sound, self._lasts = 0, True, {}
        self._begun = set()
        self.refresh()

    def refresh(self):
        """Takes in what was committed since; True when there was something."""
        with open(os.path.join(self.folder, "index.situ"), "rb") as file:
            header = file.read(INDEX_HEADER)
            if len(header) < INDEX_HEADER or header[:8] != b"SITUIDX1":
                raise Damaged("index.situ is no index; `situ store repair` rebuilds a lost one from the data")
            version, crc = struct.unpack_from("<II", header, 8)
            if version > 2:
                raise Damaged(f"version {version} is newer than this reader")
            if self._sound and crc32c(header[16:64]) != crc:
                self._sound = False
                self.note("the checksum of the index header is wrong")
            self.id = header[16:32]
            (self.created,) = struct.unpack_from("<q", header, 32)
            self.committed, self.synced = struct.unpack_from("<QQ", header, 64)
            (self.state,) = struct.unpack_from("<I", header, 80)
            room = (os.fstat(file.fileno()).st_size - INDEX_HEADER) // ENTRY
            if self.committed > room:
                self.note(f"index.situ ends before entry {self.committed}")
            before, known = len(self.entries), self._known
            file.seek(INDEX_HEADER + ENTRY * known)
            rows = file.read(ENTRY * max(min(self.committed, room) - known, 0))
        for at in range(0, len(rows) // ENTRY * ENTRY, ENTRY):
            self._take_in(rows[at : at + ENTRY], self._known)
            self._known += 1
        return len(self.entries) > before

    def _take_in(self, raw, number):
        fields = _ENTRY.unpack(raw)
        if crc32c(raw[4:]) != fields[0]:
            return self.note(f"the checksum of the index entry {number} is wrong")
        entry = dict(zip(_ENTRY_NAMES, fields[1:]), number=number)
        directory = (entry["stream"], entry["level"])
        if entry["level"] == HOLE:
            return None
        if directory in self._lasts and entry["first"] <= self._lasts[directory]:
            return self.note(f"the index entry {number} goes back in time")
        self._lasts[directory] = entry["last"]
        self.entries.append(entry)

    def note(self, sentence):
        """Lists damage, each piece of it once."""
        if len(self.damage) < _MOST_DAMAGE and sentence not in self.damage[-100:]:
            self.damage.append(sentence)

    def abandoned(self):
        """Whether the writer ended without closing the store: nobody holds its lock."""
        if self.state == 1:
            return False
        try:
            with open(os.path.join(self.folder, "lock"), "rb") as lock:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
                return True
        except FileNotFoundError:
            return True
        except OSError:
            # Somebody holds it, or nobody can say.
            return False

    def _path(self, lane, number):
        path = os.path.join(self.folder, f"{LANES[lane]}-{number:06}.situ")
        if (lane, number) not in self._begun:
            with open(path, "rb") as file:
                head = file.read(64)
            if len(head) < 64 or head[:8] != b"SITUDAT1":
                raise Damaged(f"{path} is no extent")
            _version, crc = struct.unpack_from("<II", head, 8)
            check(crc, head[16:64], f"the header of {path}")
            own = not self._sound or head[16:32] == self.id
            if not own or struct.unpack_from("<II", head, 32) != (lane, number):
                raise Damaged(f"{path} belongs elsewhere")
            self._begun.add((lane, number))
        return path

    def chunk(self, entry):
        """A chunk's header and its unpacked body."""
        if entry["lane"] not in LANES:
            raise Damaged("an index entry of an unknown lane")
        with open(self._path(entry["lane"], entry["extent"]), "rb") as file:
            file.seek(entry["offset"])
            raw = file.read(entry["length"])
        if entry["offset"] % 8 or raw[:4] not in HEADERS or len(raw) != entry["length"]:
            raise Damaged("no chunk where the index says")
        begin = HEADERS[raw[:4]]
        if len(raw) < begin:
            raise Damaged("a chunk is shorter than its header")
        header = dict(zip(_CHUNK_NAMES, _CHUNK.unpack_from(raw, 4)))
        for key in ("length", "stream", "level", "count", "first", "last", "creation"):
            if header[key] != entry[key]:
                raise Damaged(f"chunk and index disagree about {key}")
        stored = raw[begin:]
        if begin == 112:
            number, committed = struct.unpack_from("<QQ", raw, 96)
            if number != entry["number"] or committed > number:
                raise Damaged("a chunk tells another number than its entry has")
        covered = 0 if header["compression"] else header["table"]
        check(header["crc"], raw[8:begin] + stored[:covered], "a chunk's header")
        check(header["body_crc"], stored[covered:], "a chunk's body")
        body = UNPACK[header["compression"]](stored, header["raw"])
        if len(body) != header["raw"]:
            raise Damaged("a chunk unpacks to another length")
        return header, body

    def messages(self, entry):
        """The messages of a chunk as dicts: `time`, `creation`, `sequence`, `encoding`, and `data` or `bytes`."""
        header, body = self.chunk(entry)
        table, payload = Cursor(body[: header["table"]]), Cursor(body, header["table"])
        encoding = header["encoding"]
        sequence = header["sequence"] - 1
        time = header["first"]
        latency = signed(header["creation"] - header["first"])
        for _ in range(header["count"]):
            sequence = (sequence + table.zigzag() + 1) & MASK
            time = signed(time + table.varint())
            latency = signed(latency + table.zigzag())
            message = {"sequence": sequence, "time": time, "creation": signed(time + latency)}
            if encoding == INTS:
                message["data"] = payload.zigzag()
            elif encoding == FLOATS:
                (message["data"],) = payload.unpack("<d")
            elif encoding == BOOLEANS:
                message["data"] = {0: False, 1: True}.get(payload.take(1)[0])
            else:
                message["bytes"] = payload.take(table.varint())
            message["encoding"] = encoding
            if encoding == CODEC:
                message["codec"] = header["codec"]
            yield message
        if time != header["last"]:
            raise Damaged("the last message has another time than the chunk says")

    def catalog(self):
        """The store's record, and by number the records of its streams."""
        streams, store = {}, {}
        for entry in self.of(0, 0):
            for message in self._sound_messages(entry):
                try:
                    record = json.loads(message["bytes"])
                    kind = record["kind"]
                except (ValueError, KeyError, TypeError):
                    # A record nobody understands takes nothing else with it.
                    continue
                stream = streams.setdefault(record.get("id"), {"codecs": {}})
                if kind == "store":
                    store = record
                elif kind == "codec":
                    stream["codecs"][record["number"]] = record["name"]
                else:
                    stream[kind] = record
        return store, {id: stream for id, stream in streams.items() if "stream" in stream}

    def _sound_messages(self, entry):
        # A damaged part of the catalog: what follows it is still good.
        try:
            yield from self.messages(entry)
        except Damaged as error:
            self.note(f"the catalog, entry {entry['number']} of the index: {error}")

    def of(self, stream, level):
        """The entries of a stream and level, in order of time."""
        return [e for e in self.entries if e["stream"] == stream and e["level"] == level]
