"""Checksums, compression and variable-length numbers: what files are made of."""

import functools
import shutil
import struct
import subprocess

MASK = (1 << 64) - 1


class Damaged(Exception):
    """Bytes that are not what they should be; the text says which."""


class Missing(Exception):
    """A package or program that is needed here is not installed; the text says which."""


def _table():
    """The checksum of each byte."""
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = (byte >> 1) ^ (0x82F63B78 if byte & 1 else 0)
        table.append(byte)
    return table


_TABLE = _table()
# Bytes of a lane, of few bytes and of many: numpy goes through all lanes at once, two bytes a step.
_SHORT_LANE, _LONG_LANE, _MANY = 64, 1_024, 131_072


def _advance(crc, data):
    """The register after some bytes."""
    for byte in data:
        crc = _TABLE[(crc ^ byte) & 0xFF] ^ (crc >> 8)
    return crc


@functools.lru_cache
def _skips(lane):
    """The register after a lane of zeros, by each of the four bytes it had before. It is linear in them."""
    zeros = bytes(lane)
    bits = [_advance(1 << bit, zeros) for bit in range(32)]
    tables = []
    for at in range(0, 32, 8):
        table = [0]
        for bit in range(8):
            table += [known ^ bits[at + bit] for known in table]
        tables.append(table)
    return tables


def _plain_crc32c(data):
    return _advance(0xFFFFFFFF, data) ^ 0xFFFFFFFF


def _numpy_crc32c(np):
    """By numpy: each lane begins with a register of 0, and then they are put together."""
    one = np.array(_TABLE, "u4")
    first = one[np.arange(65_536) & 255] ^ (np.arange(65_536, dtype="u4") >> 8)
    two = one[first & 255] ^ (first >> 8)

    def crc32c(data):
        size = _LONG_LANE if len(data) >= _MANY else _SHORT_LANE
        lanes = len(data) // size
        if lanes < 16:
            return _plain_crc32c(data)
        pairs = np.ascontiguousarray(np.frombuffer(data, "<u2", lanes * size // 2).reshape(lanes, -1).T)
        registers = np.zeros(lanes, "u4")
        for row in pairs:
            registers = two[(registers ^ row) & 0xFFFF] ^ (registers >> 16)
        a, b, c, d = _skips(size)
        crc = 0xFFFFFFFF
        for lane in registers.tolist():
            crc = lane ^ a[crc & 255] ^ b[crc >> 8 & 255] ^ c[crc >> 16 & 255] ^ d[crc >> 24]
        return _advance(crc, data[lanes * size :]) ^ 0xFFFFFFFF

    return crc32c


def _fastest_crc32c():
    try:
        from google_crc32c import value
    except ImportError:
        pass
    else:
        return lambda data: value(bytes(data))
    try:
        import numpy
    except ImportError:
        return _plain_crc32c
    return _numpy_crc32c(numpy)


_fastest = _fastest_crc32c()


def crc32c(data):
    """
    CRC-32C (Castagnoli).

    >>> hex(crc32c(b"123456789"))
    '0xe3069283'
    """
    return _fastest(data)


def check(crc, data, what):
    """Raises `Damaged` when the checksum is another."""
    if crc32c(data) != crc:
        raise Damaged(f"the checksum of {what} is wrong")


def signed(value):
    value &= MASK
    return value - (1 << 64) if value >> 63 else value


def zigzag(value):
    return (value << 1) ^ (value >> 63)


def unzigzag(value):
    return (value >> 1) ^ -(value & 1)


def varint(value):
    """
    >>> varint(300).hex()
    'ac02'
    """
    out = bytearray()
    value &= MASK
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


class Cursor:
    """Reads one thing after the other; `Damaged` at the end of the bytes."""

    def __init__(self, data, at=0):
        self.data, self.at = data, at

    def varint(self):
        value = shift = 0
        while True:
            byte = self.take(1)[0]
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value & MASK
            shift += 7
            if shift > 63:
                raise Damaged("a number has too many bytes")

    def zigzag(self):
        return unzigzag(self.varint())

    def take(self, length):
        part = self.data[self.at : self.at + length]
        if len(part) != length:
            raise Damaged("a payload reaches beyond its chunk")
        self.at += length
        return part

    def unpack(self, layout):
        return struct.unpack(layout, self.take(struct.calcsize(layout)))


def _unpack_lz4(stored, length):
    try:
        import lz4.block

        return lz4.block.decompress(stored, uncompressed_size=length)
    except ImportError:
        return _plain_lz4(stored, length)
    except Exception as error:
        raise Damaged(f"an LZ4 block: {error}") from error


def _plain_lz4(stored, most):
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
        length = more(token & 15) + 4
        if not 0 < distance <= len(out) or len(out) + length > most:
            raise Damaged("an LZ4 block copies what is not there")
        for _ in range(length):
            out.append(out[-distance])


def _unpack_zstd(stored, length):
    try:
        import zstandard

        return zstandard.ZstdDecompressor().decompress(stored, max_output_size=length)
    except ImportError:
        pass
    except Exception as error:
        raise Damaged(f"a zstd frame: {error}") from error
    if not shutil.which("zstd"):
        raise Missing("zstd: install the package zstandard, or the program zstd")
    return subprocess.run(["zstd", "-dcq"], input=stored, stdout=subprocess.PIPE, check=True).stdout


UNPACK = {0: lambda stored, length: stored, 1: _unpack_lz4, 2: _unpack_zstd}
