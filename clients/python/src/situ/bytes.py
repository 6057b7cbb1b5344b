"""Checksums, compression and variable-length numbers: what files are made of."""

import shutil
import struct
import subprocess

MASK = (1 << 64) - 1


class Damaged(Exception):
    """Bytes that are not what they should be; the text says which."""


class Missing(Exception):
    """A package or program that is needed here is not installed; the text says which."""


def _table():
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = (byte >> 1) ^ (0x82F63B78 if byte & 1 else 0)
        table.append(byte)
    return table


_TABLE = _table()


def _plain_crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc = _TABLE[(crc ^ byte) & 0xFF] ^ (crc >> 8)
    return crc ^ 0xFFFFFFFF


try:
    from google_crc32c import value as _fast_crc32c

    def crc32c(data):
        """CRC-32C (Castagnoli)."""
        return _fast_crc32c(bytes(data))

except ImportError:
    crc32c = _plain_crc32c


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
