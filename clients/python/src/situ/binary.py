"""Checksums, compression and variable-length integers: the building blocks of the file format."""

from __future__ import annotations

import functools
import shutil
import struct
import subprocess
from typing import Any, Callable, Union

Buffer = Union[bytes, bytearray, memoryview]

MASK = (1 << 64) - 1
# The encodings of a chunk's messages.
BINS, INTS, FLOATS, BINARIES, TERMS, CODEC, BOOLEANS, TRACKS = range(8)


class Damaged(Exception):
    """Raised for bytes that violate their format. The message describes the violation."""


class Missing(Exception):
    """Raised if a required package or program is not installed. The message names it."""


def _build_crc_table() -> list[int]:
    """Returns the CRC register after each possible byte."""
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = (byte >> 1) ^ (0x82F63B78 if byte & 1 else 0)
        table.append(byte)
    return table


_TABLE = _build_crc_table()
# numpy updates the registers of all lanes together, two bytes per step. Longer data has longer lanes (in bytes).
_SHORT_LANE, _LONG_LANE, _MANY = 64, 1_024, 131_072


def _update_crc(crc: int, data: Buffer) -> int:
    """Returns the CRC register after `data`."""
    for byte in data:
        crc = _TABLE[(crc ^ byte) & 0xFF] ^ (crc >> 8)
    return crc


@functools.lru_cache
def _build_skip_tables(lane: int) -> list[list[int]]:
    """Returns a table per register byte: its contribution to the register after `lane` zero bytes.

    The register after zeros is linear in the register before them, so the four contributions are combined by XOR.
    """
    zeros = bytes(lane)
    bits = [_update_crc(1 << bit, zeros) for bit in range(32)]
    tables = []
    for at in range(0, 32, 8):
        table = [0]
        for bit in range(8):
            table += [known ^ bits[at + bit] for known in table]
        tables.append(table)
    return tables


def _plain_crc32c(data: Buffer) -> int:
    return _update_crc(0xFFFFFFFF, data) ^ 0xFFFFFFFF


def _build_numpy_crc32c(np: Any) -> Callable[[Buffer], int]:
    """Builds a numpy implementation: each lane starts with a register of 0, and the lanes are then combined."""
    one = np.array(_TABLE, "u4")
    first = one[np.arange(65_536) & 255] ^ (np.arange(65_536, dtype="u4") >> 8)
    two = one[first & 255] ^ (first >> 8)

    def crc32c(data: Buffer) -> int:
        size = _LONG_LANE if len(data) >= _MANY else _SHORT_LANE
        lanes = len(data) // size
        if lanes < 16:
            return _plain_crc32c(data)
        pairs = np.ascontiguousarray(np.frombuffer(data, "<u2", lanes * size // 2).reshape(lanes, -1).T)
        registers = np.zeros(lanes, "u4")
        for row in pairs:
            registers = two[(registers ^ row) & 0xFFFF] ^ (registers >> 16)
        a, b, c, d = _build_skip_tables(size)
        crc = 0xFFFFFFFF
        for lane in registers.tolist():
            crc = lane ^ a[crc & 255] ^ b[crc >> 8 & 255] ^ c[crc >> 16 & 255] ^ d[crc >> 24]
        return _update_crc(crc, data[lanes * size :]) ^ 0xFFFFFFFF

    return crc32c


def _select_crc32c() -> Callable[[Buffer], int]:
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
    return _build_numpy_crc32c(numpy)


_crc32c = _select_crc32c()


def crc32c(data: Buffer) -> int:
    """
    Returns the CRC-32C (Castagnoli) of bytes.

    >>> hex(crc32c(b"123456789"))
    '0xe3069283'
    """
    return _crc32c(data)


def verify_checksum(crc: int, data: Buffer, what: str) -> None:
    """Raises `Damaged` unless `crc` is the checksum of `data`. `what` describes the data in the error."""
    if crc32c(data) != crc:
        raise Damaged(f"the checksum of {what} does not match")


def to_signed64(value: int) -> int:
    """Wraps an integer to a signed 64-bit integer."""
    value &= MASK
    return value - (1 << 64) if value >> 63 else value


def encode_zigzag(value: int) -> int:
    """Maps a signed integer to an unsigned one, small magnitudes to small numbers."""
    return (value << 1) ^ (value >> 63)


def decode_zigzag(value: int) -> int:
    """Reverses `encode_zigzag`."""
    return (value >> 1) ^ -(value & 1)


def encode_varint(value: int) -> bytes:
    """
    Encodes an unsigned 64-bit integer in groups of 7 bits, lowest first.

    >>> encode_varint(300).hex()
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
    """Reads values in sequence. Raises `Damaged` at the end of the bytes."""

    def __init__(self, data: Buffer, position: int = 0) -> None:
        self.data, self.position = data, position

    def read_varint(self) -> int:
        value = shift = 0
        while True:
            byte = self.read_bytes(1)[0]
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value & MASK
            shift += 7
            if shift > 63:
                raise Damaged("an integer has more than 10 bytes")

    def read_zigzag(self) -> int:
        return decode_zigzag(self.read_varint())

    def read_bytes(self, length: int) -> Buffer:
        part = self.data[self.position : self.position + length]
        if len(part) != length:
            raise Damaged("a payload extends past the end of its chunk")
        self.position += length
        return part

    def read_struct(self, layout: str) -> tuple[Any, ...]:
        return struct.unpack(layout, self.read_bytes(struct.calcsize(layout)))


def _decompress_lz4(stored: Buffer, length: int) -> bytes:
    try:
        import lz4.block  # type: ignore[import-untyped, unused-ignore]

        unpacked: bytes = lz4.block.decompress(stored, uncompressed_size=length)
        return unpacked
    except ImportError:
        return _decompress_plain_lz4(stored, length)
    except Exception as error:
        raise Damaged(f"invalid LZ4 block: {error}") from error


def _decompress_plain_lz4(stored: Buffer, max_length: int) -> bytes:
    """Decompresses LZ4's block format: alternating literals and copies of at least 4 earlier bytes."""
    out, cursor = bytearray(), Cursor(stored)

    def read_length(length: int) -> int:
        while length >= 15:
            (byte,) = cursor.read_bytes(1)
            length += byte
            if byte < 255:
                break
        return length

    while True:
        (token,) = cursor.read_bytes(1)
        out += cursor.read_bytes(read_length(token >> 4))
        if cursor.position == len(stored):
            return bytes(out)
        (distance,) = struct.unpack("<H", cursor.read_bytes(2))
        length = read_length(token & 15) + 4
        if not 0 < distance <= len(out) or len(out) + length > max_length:
            raise Damaged("invalid LZ4 block: a copy refers to bytes outside the output")
        for _ in range(length):
            out.append(out[-distance])


def _decompress_zstd(stored: Buffer, length: int) -> bytes:
    try:
        import zstandard

        raw: bytes = zstandard.ZstdDecompressor().decompress(stored, max_output_size=length)
        return raw
    except ImportError:
        pass
    except Exception as error:
        raise Damaged(f"invalid zstd frame: {error}") from error
    if not shutil.which("zstd"):
        raise Missing("zstd is not installed: pip install situ[zstd], or install the program zstd")
    return subprocess.run(["zstd", "-dcq"], input=stored, stdout=subprocess.PIPE, check=True).stdout


DECOMPRESSORS = {0: lambda stored, length: stored, 1: _decompress_lz4, 2: _decompress_zstd}
