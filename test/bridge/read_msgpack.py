"""Reads Situ's MessagePack file: frames with a length and a map, and a length of 0 at the end."""
import struct
import sys

import msgpack

data = open(sys.argv[1], "rb").read()
at, found = 0, []
while True:
    (size,) = struct.unpack_from("<i", data, at)
    if size == 0:
        break
    found.append(msgpack.unpackb(data[at + 4 : at + 4 + size]))
    at += 4 + size
assert at + 4 == len(data)
assert [m["message"]["n"] for m in found] == list(range(1, 101))
assert found[0]["originatingTime"] == 621355968000000001, found[0]
