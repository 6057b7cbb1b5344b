#!/usr/bin/env python3
"""A second reader of Situ stores, written from priv/schema/store.md alone. Standard library only.

    read_store.py FOLDER            every message of every stream, one JSON object a line
    read_store.py --bins FOLDER     the stored pyramids, signals as lists and tracks as objects

Chunks compressed with zstd need the program zstd; without it the rest of their stream is left out, and a line says so. Any other
trouble is said on standard error and ends with status 1.
"""

import base64
import json
import os
import shutil
import struct
import subprocess
import sys

DATA, LARGE = 0, 1
HEADERS = {b"CHNK": 96, b"CHK2": 112}
LANES = {DATA: "data", LARGE: "large"}
BINS, INTS, FLOATS, BINARIES, TERMS, CODEC, BOOLEANS, TRACKS = range(8)
HOLE = 255
MASK = (1 << 64) - 1


class Damaged(Exception):
    pass


class Skipped(Exception):
    pass


def crc_table():
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = (byte >> 1) ^ (0x82F63B78 if byte & 1 else 0)
        table.append(byte)
    return table


TABLE = crc_table()


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc = TABLE[(crc ^ byte) & 0xFF] ^ (crc >> 8)
    return crc ^ 0xFFFFFFFF


def check(crc, data, what):
    if crc32c(data) != crc:
        raise Damaged(f"the checksum of {what} is wrong")


def signed(value):
    value &= MASK
    return value - (1 << 64) if value >> 63 else value


def unzigzag(value):
    return (value >> 1) ^ -(value & 1)


class Cursor:
    def __init__(self, data, at=0):
        self.data, self.at = data, at

    def varint(self):
        value = shift = 0
        while True:
            byte = self.data[self.at]
            self.at += 1
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value & MASK
            shift += 7

    def zigzag(self):
        return unzigzag(self.varint())

    def take(self, length):
        part = self.data[self.at : self.at + length]
        if len(part) != length:
            raise Damaged("a payload reaches beyond its chunk")
        self.at += length
        return part


def unpack_lz4(stored, length):
    """LZ4's block format: literals, then a match of at least 4 bytes so many bytes back, again and again."""
    out, cursor = bytearray(), Cursor(stored)

    def more(length):
        while length >= 15:
            (byte,) = cursor.take(1)
            length += byte
            if byte < 255:
                break
        return length

    while True:
        (token,) = cursor.take(1)
        out += cursor.take(more(token >> 4))
        if cursor.at == len(stored):
            return bytes(out)
        (distance,) = struct.unpack("<H", cursor.take(2))
        for _ in range(more(token & 15) + 4):
            out.append(out[-distance])


def unpack_zstd(stored, length):
    if not shutil.which("zstd"):
        raise Skipped("zstd")
    return subprocess.run(["zstd", "-dcq"], input=stored, stdout=subprocess.PIPE, check=True).stdout


UNPACK = {0: lambda stored, length: stored, 1: unpack_lz4, 2: unpack_zstd}


class Store:
    def __init__(self, folder):
        self.folder = folder
        self.extents = {}
        with open(os.path.join(folder, "index.situ"), "rb") as file:
            index = file.read()
        if index[:8] != b"SITUIDX1":
            raise Damaged("index.situ is no index")
        version, crc = struct.unpack_from("<II", index, 8)
        if version > 2:
            raise Damaged(f"version {version} is newer than this reader")
        check(crc, index[16:64], "the index header")
        self.id = index[16:32]
        (self.created,) = struct.unpack_from("<q", index, 32)
        self.committed, self.synced = struct.unpack_from("<QQ", index, 64)
        (self.state,) = struct.unpack_from("<I", index, 80)
        self.entries = [self.entry(index, 4096 + 64 * n) for n in range(self.committed)]

    @staticmethod
    def entry(index, at):
        raw = index[at : at + 64]
        fields = struct.unpack("<IIBBHIQIIQqqq", raw)
        check(fields[0], raw[4:], f"the index entry at byte {at}")
        names = "stream level lane zero extent offset length count ordinal first last creation"
        return dict(zip(names.split(), fields[1:]))

    def extent(self, lane, number):
        if (lane, number) not in self.extents:
            path = os.path.join(self.folder, f"{LANES[lane]}-{number:06}.situ")
            with open(path, "rb") as file:
                data = file.read()
            if data[:8] != b"SITUDAT1":
                raise Damaged(f"{path} is no extent")
            version, crc = struct.unpack_from("<II", data, 8)
            check(crc, data[16:64], f"the header of {path}")
            if (data[16:32], *struct.unpack_from("<II", data, 32)) != (self.id, lane, number):
                raise Damaged(f"{path} belongs elsewhere")
            self.extents[lane, number] = data
        return self.extents[lane, number]

    def chunk(self, entry):
        data = self.extent(entry["lane"], entry["extent"])
        raw = data[entry["offset"] : entry["offset"] + entry["length"]]
        if entry["offset"] % 8 or raw[:4] not in HEADERS:
            raise Damaged("no chunk where the index says")
        begin = HEADERS[raw[:4]]
        names = "crc length stream level encoding compression zero count ordinal first last sequence creation size latency "
        names += "raw table codec zero2 body_crc"
        header = dict(zip(names.split(), struct.unpack_from("<IIIBBBBIQqqQqQdIIHHI", raw, 4)))
        for key in ("length", "stream", "level", "count", "first", "last", "creation"):
            if header[key] != entry[key]:
                raise Damaged(f"chunk and index disagree about {key}")
        stored = raw[begin:]
        if begin == 112:
            number, committed = struct.unpack_from("<QQ", raw, 96)
            if self.entries[number] is not entry or committed > number:
                raise Damaged("a chunk tells another number than its entry has")
        covered = 0 if header["compression"] else header["table"]
        check(header["crc"], raw[8:begin] + stored[:covered], "a chunk's header")
        check(header["body_crc"], stored[covered:], "a chunk's body")
        body = UNPACK[header["compression"]](stored, header["raw"])
        if len(body) != header["raw"]:
            raise Damaged("a chunk unpacks to another length")
        return header, body

    def messages(self, entry):
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
                (message["data"],) = struct.unpack("<d", payload.take(8))
            elif encoding == BOOLEANS:
                message["data"] = [False, True, None][payload.take(1)[0]]
            else:
                message["bytes"] = payload.take(table.varint())
            message["encoding"] = encoding
            if encoding == CODEC:
                message["codec"] = header["codec"]
            yield message
        if time != header["last"]:
            raise Damaged("the last message has another time than the chunk says")

    def bins(self, entry):
        header, body = self.chunk(entry)
        for n in range(header["count"]):
            yield struct.unpack_from("<qdddQ", body, n * 40)

    def tallies(self, entry):
        header, body = self.chunk(entry)
        cursor, width = Cursor(body), 1 << (entry["level"] - 64)
        keys = [None] + [cursor.take(cursor.varint()) for _ in range(cursor.varint())]
        states = [None] + [cursor.take(cursor.varint()) for _ in range(cursor.varint())]
        start = header["first"]
        for _ in range(header["count"]):
            start += cursor.varint() * width
            bin = {"start": start, "count": cursor.varint(), "tracks": []}
            for _ in range(cursor.varint()):
                key, kind = divmod(cursor.varint(), 2)
                if kind == 0:
                    count, values = cursor.varint(), struct.unpack("<ddd", cursor.take(24))
                    track = {"count": count, "numbers": values}
                else:
                    changes, first, last = cursor.varint(), cursor.varint(), cursor.varint()
                    counts = [(term(states[cursor.varint()]), cursor.varint()) for _ in range(cursor.varint())]
                    track = {"changes": changes, "first": term(states[first]), "last": term(states[last]), "states": counts}
                bin["tracks"].append(dict(track, key=term(keys[key])))
            yield bin
        if cursor.at != len(body):
            raise Damaged("bins end before their chunk")

    def catalog(self):
        streams, store = {}, {}
        for entry in self.of(0, 0):
            for message in self.messages(entry):
                record = json.loads(message["bytes"])
                stream = streams.setdefault(record.get("id"), {"codecs": {}})
                if record["kind"] == "store":
                    store = record
                elif record["kind"] == "codec":
                    stream["codecs"][record["number"]] = record["name"]
                else:
                    stream[record["kind"]] = record
        return store, {id: stream for id, stream in streams.items() if "stream" in stream}

    def of(self, stream, level):
        return [e for e in self.entries if e["stream"] == stream and e["level"] == level and e["level"] != HOLE]


def term(external):
    return external and base64.b64encode(external).decode()


def dump(store):
    name, streams = store.catalog()
    print(json.dumps({"store": name["name"], "closed": store.state == 1, "created": store.created}))
    for id, stream in sorted(streams.items()):
        record, closed = stream["stream"], stream.get("closed", {})
        head = {"stream": record["name"], "type": record["type"], "closed": closed.get("time")}
        if "metadata" in stream:
            head["metadata"] = stream["metadata"]["term"]
        entries = store.of(id, 0)
        if entries:
            last, _ = store.chunk(entries[-1])
            count = entries[-1]["ordinal"] + entries[-1]["count"]
            head |= {"count": count, "size": last["size"]}
            head["latency"] = last["latency"]
        print(json.dumps(head))
        try:
            for entry in entries:
                for message in store.messages(entry):
                    if "codec" in message:
                        message["codec"] = stream["codecs"][message["codec"]]
                    if "bytes" in message:
                        message["bytes"] = base64.b64encode(message["bytes"]).decode()
                    print(json.dumps(message))
        except Skipped as tool:
            print(json.dumps({"skipped": str(tool)}))


def dump_bins(store):
    _, streams = store.catalog()
    for id, stream in sorted(streams.items()):
        for level in range(1, 64):
            for entry in store.of(id, level):
                for bin in store.bins(entry):
                    print(json.dumps([stream["stream"]["name"], level, *bin]))
        for level in range(65, 127):
            for entry in store.of(id, level):
                for bin in store.tallies(entry):
                    print(json.dumps(dict(bin, stream=stream["stream"]["name"], level=level)))


def main(arguments):
    try:
        if arguments[0] == "--bins":
            dump_bins(Store(arguments[1]))
        else:
            dump(Store(arguments[0]))
    except Damaged as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
