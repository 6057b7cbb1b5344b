"""Decodes whole chunks of numbers to numpy arrays."""

from __future__ import annotations

from typing import Any, Optional

from .binary import BOOLEANS, FLOATS, INTS, Buffer, Damaged

_NIL = 2


def decode_chunk(np: Any, header: dict[str, Any], body: Buffer) -> Optional[tuple[Any, Any]]:
    """Returns the times (int64) and values of a chunk's messages, or None if its values are not plain numbers."""
    if header["encoding"] not in (INTS, FLOATS, BOOLEANS):
        return None
    count, table = header["count"], header["table"]
    steps = _decode_varints(np, body[:table], 3 * count).reshape(count, 3)
    # The format defines times as wrapping sums, and sums of numpy's 64-bit integers wrap as well.
    times = (np.cumsum(steps[:, 1], dtype="u8") + np.uint64(header["first"] & 0xFFFFFFFFFFFFFFFF)).view("i8")
    if count and int(times[-1]) != header["last"]:
        raise Damaged("the last message's time differs from the chunk header")
    values = _decode_values(np, header["encoding"], body[table:], count)
    return None if values is None else (times, values)


def _decode_values(np: Any, encoding: int, payload: Buffer, count: int) -> Any:
    if encoding == INTS:
        zigzags = _decode_varints(np, payload, count)
        return (zigzags >> np.uint64(1)).view("i8") ^ -(zigzags & np.uint64(1)).view("i8")
    size = 8 if encoding == FLOATS else 1
    if len(payload) < size * count:
        raise Damaged("a payload extends past the end of its chunk")
    if encoding == FLOATS:
        return np.frombuffer(payload, "<f8", count)
    truths = np.frombuffer(payload, "u1", count)
    return None if (truths >= _NIL).any() else truths == 1


def _decode_varints(np: Any, raw: Any, count: int) -> Any:
    """Decodes the first `count` variable-length integers."""
    raw = np.frombuffer(raw, "u1")
    ends = np.flatnonzero(raw < 0x80)[:count]
    if len(ends) < count:
        raise Damaged("a payload extends past the end of its chunk")
    starts = np.concatenate((np.zeros(min(count, 1), "i8"), ends[:-1] + 1))
    lengths = ends - starts + 1
    longest = int(lengths.max(initial=0))
    if longest > 10:
        raise Damaged("an integer has more than 10 bytes")
    numbers = np.zeros(count, "u8")
    for at in range(longest):
        rows = np.flatnonzero(lengths > at) if at else slice(None)
        numbers[rows] |= (raw[starts[rows] + at] & 0x7F).astype("u8") << np.uint64(7 * at)
    return numbers
