"""Chunks of numbers as numpy arrays: all messages of a chunk at once."""

from .bytes import Damaged
from .layout import BOOLEANS, FLOATS, INTS

_NIL = 2


def decode(np, header, body):
    """Times (int64) and values of a chunk's messages, or None where they are no plain numbers."""
    if header["encoding"] not in (INTS, FLOATS, BOOLEANS):
        return None
    count, table = header["count"], header["table"]
    steps = _varints(np, body[:table], 3 * count).reshape(count, 3)
    # Sums of 64-bit numbers wrap, as the format's do.
    times = (np.cumsum(steps[:, 1], dtype="u8") + np.uint64(header["first"] & 0xFFFFFFFFFFFFFFFF)).view("i8")
    if count and int(times[-1]) != header["last"]:
        raise Damaged("the last message has another time than the chunk says")
    values = _values(np, header["encoding"], body[table:], count)
    return None if values is None else (times, values)


def _values(np, encoding, payload, count):
    if encoding == INTS:
        zigzags = _varints(np, payload, count)
        return (zigzags >> np.uint64(1)).view("i8") ^ -(zigzags & np.uint64(1)).view("i8")
    size = 8 if encoding == FLOATS else 1
    if len(payload) < size * count:
        raise Damaged("a payload reaches beyond its chunk")
    if encoding == FLOATS:
        return np.frombuffer(payload, "<f8", count)
    truths = np.frombuffer(payload, "u1", count)
    return None if (truths >= _NIL).any() else truths == 1


def _varints(np, raw, count):
    """The first `count` numbers of seven bits a byte, the lowest first."""
    raw = np.frombuffer(raw, "u1")
    ends = np.flatnonzero(raw < 0x80)[:count]
    if len(ends) < count:
        raise Damaged("a payload reaches beyond its chunk")
    starts = np.concatenate((np.zeros(min(count, 1), "i8"), ends[:-1] + 1))
    lengths = ends - starts + 1
    longest = int(lengths.max(initial=0))
    if longest > 10:
        raise Damaged("a number has too many bytes")
    numbers = np.zeros(count, "u8")
    for at in range(longest):
        rows = np.flatnonzero(lengths > at) if at else slice(None)
        numbers[rows] |= (raw[starts[rows] + at] & 0x7F).astype("u8") << np.uint64(7 * at)
    return numbers
