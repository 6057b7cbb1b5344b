#!/usr/bin/env python3
"""Every message of a Situ store, by the second reader of the format (clients/python), which knows priv/schema/store.md alone.

    read_store.py FOLDER            every message of every stream, one JSON object a line
    read_store.py --bins FOLDER     the stored pyramids, signals as lists and tracks as objects

Chunks compressed with zstd need the program zstd (or the package zstandard); without it the rest of their stream is left out, and a
line says so. Any other trouble is said on standard error and ends with status 1.
"""

import base64
import json
import os
import struct
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../clients/python/src"))
from situ.bytes import Cursor, Damaged, Missing  # noqa: E402
from situ.layout import Files  # noqa: E402


def bins(files, entry):
    header, body = files.chunk(entry)
    for n in range(header["count"]):
        yield struct.unpack_from("<qdddQ", body, n * 40)


def tallies(files, entry):
    header, body = files.chunk(entry)
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
                track = {"count": cursor.varint(), "numbers": cursor.unpack("<ddd")}
            else:
                changes, first, last = cursor.varint(), cursor.varint(), cursor.varint()
                counts = [(term(states[cursor.varint()]), cursor.varint()) for _ in range(cursor.varint())]
                track = {"changes": changes, "first": term(states[first]), "last": term(states[last]), "states": counts}
            bin["tracks"].append(dict(track, key=term(keys[key])))
        yield bin
    if cursor.at != len(body):
        raise Damaged("bins end before their chunk")


def term(external):
    return external and base64.b64encode(external).decode()


def dump(files):
    name, streams = files.catalog()
    print(json.dumps({"store": name["name"], "closed": files.state == 1, "created": files.created}))
    for id, stream in sorted(streams.items()):
        record, closed = stream["stream"], stream.get("closed", {})
        head = {"stream": record["name"], "type": record["type"], "closed": closed.get("time")}
        if "metadata" in stream:
            head["metadata"] = stream["metadata"]["term"]
        entries = files.of(id, 0)
        if entries:
            last, _ = files.chunk(entries[-1])
            head |= {"count": entries[-1]["ordinal"] + entries[-1]["count"], "size": last["size"], "latency": last["latency"]}
        print(json.dumps(head))
        try:
            for entry in entries:
                for message in files.messages(entry):
                    if "codec" in message:
                        message["codec"] = stream["codecs"][message["codec"]]
                    if "bytes" in message:
                        message["bytes"] = base64.b64encode(message["bytes"]).decode()
                    print(json.dumps(message))
        except Missing:
            print(json.dumps({"skipped": "zstd"}))


def dump_bins(files):
    _, streams = files.catalog()
    for id, stream in sorted(streams.items()):
        for level in range(1, 64):
            for entry in files.of(id, level):
                for bin in bins(files, entry):
                    print(json.dumps([stream["stream"]["name"], level, *bin]))
        for level in range(65, 127):
            for entry in files.of(id, level):
                for bin in tallies(files, entry):
                    print(json.dumps(dict(bin, stream=stream["stream"]["name"], level=level)))


def main(arguments):
    try:
        if arguments[0] == "--bins":
            dump_bins(Files(arguments[1]))
        else:
            dump(Files(arguments[0]))
    except Damaged as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
