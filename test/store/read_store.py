#!/usr/bin/env python3
"""Prints every message of a Situ store, with the second reader of the format (clients/python).

    read_store.py FOLDER            prints every message of every stream, one JSON object per line
    read_store.py --bins FOLDER     prints the stored pyramids, signals as lists and tracks as objects

Chunks compressed with zstd require the program zstd (or the package zstandard). Without it, the rest of their stream is
omitted, and a line reports it. Any other error is printed on standard error and ends with status 1.
"""

import base64
import json
import os
import struct
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../clients/python/src"))
from situ.binary import Cursor, Damaged, Missing  # noqa: E402
from situ.layout import StoreFiles  # noqa: E402


def find_entries(files, stream, level):
    return [entry for entry in files.entries if (entry["stream"], entry["level"]) == (stream, level)]


def read_bins(files, entry):
    header, body = files.read_chunk(entry)
    for n in range(header["count"]):
        yield struct.unpack_from("<qdddQ", body, n * 40)


def read_track_bins(files, entry):
    header, body = files.read_chunk(entry)
    cursor, width = Cursor(body), 1 << (entry["level"] - 64)
    keys = [None] + [cursor.read_bytes(cursor.read_varint()) for _ in range(cursor.read_varint())]
    states = [None] + [cursor.read_bytes(cursor.read_varint()) for _ in range(cursor.read_varint())]
    start = header["first"]
    for _ in range(header["count"]):
        start += cursor.read_varint() * width
        bin = {"start": start, "count": cursor.read_varint(), "tracks": []}
        for _ in range(cursor.read_varint()):
            key, kind = divmod(cursor.read_varint(), 2)
            if kind == 0:
                track = {"count": cursor.read_varint(), "numbers": cursor.read_struct("<ddd")}
            else:
                changes, first, last = cursor.read_varint(), cursor.read_varint(), cursor.read_varint()
                counts = [(encode_term(states[cursor.read_varint()]), cursor.read_varint()) for _ in range(cursor.read_varint())]
                track = {"changes": changes, "first": encode_term(states[first]), "last": encode_term(states[last]), "states": counts}
            bin["tracks"].append(dict(track, key=encode_term(keys[key])))
        yield bin
    if cursor.position != len(body):
        raise Damaged("a chunk has extra bytes after its bins")


def encode_term(external):
    return external and base64.b64encode(external).decode()


def dump_messages(files):
    name, streams = files.read_catalog()
    print(json.dumps({"store": name["name"], "closed": files.state == 1, "created": files.created}))
    for id, stream in sorted(streams.items()):
        record, closed = stream["stream"], stream.get("closed", {})
        head = {"stream": record["name"], "type": record["type"], "closed": closed.get("time")}
        if "metadata" in stream:
            head["metadata"] = stream["metadata"]["term"]
        entries = find_entries(files, id, 0)
        if entries:
            last, _ = files.read_chunk(entries[-1])
            head |= {"count": entries[-1]["ordinal"] + entries[-1]["count"], "size": last["size"], "latency": last["latency"]}
        print(json.dumps(head))
        try:
            for entry in entries:
                for message in files.read_messages(entry):
                    if "codec" in message:
                        message["codec"] = stream["codecs"][message["codec"]]
                    if "bytes" in message:
                        message["bytes"] = base64.b64encode(message["bytes"]).decode()
                    print(json.dumps(message))
        except Missing:
            print(json.dumps({"skipped": "zstd"}))


def dump_bins(files):
    _, streams = files.read_catalog()
    for id, stream in sorted(streams.items()):
        for level in range(1, 64):
            for entry in find_entries(files, id, level):
                for bin in read_bins(files, entry):
                    print(json.dumps([stream["stream"]["name"], level, *bin]))
        for level in range(65, 127):
            for entry in find_entries(files, id, level):
                for bin in read_track_bins(files, entry):
                    print(json.dumps(dict(bin, stream=stream["stream"]["name"], level=level)))


def run_command(arguments):
    try:
        if arguments[0] == "--bins":
            dump_bins(StoreFiles(arguments[1]))
        else:
            dump_messages(StoreFiles(arguments[0]))
    except Damaged as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(run_command(sys.argv[1:]))
