"""Erlang's external term format: what messages without a layout of their own are written in.

| Erlang, Elixir | Python |
|---|---|
| integer, float, list, tuple, map | int, float, list, tuple, dict |
| `true`, `false`, `nil` | True, False, None |
| `:nan`, `:infinity`, `:neg_infinity` (as values) | float |
| other atoms | `Atom`, a str |
| binary | str where it is UTF-8, else bytes |
| struct | `Struct`, a dict with `.module` and its fields as attributes |
"""

import math
import struct

from .bytes import Cursor, Damaged

DEEPEST = 512
_VERSION = 131
_NUMBERS = {"nan": math.nan, "infinity": math.inf, "neg_infinity": -math.inf}
_WORDS = {"true": True, "false": False, "nil": None, **_NUMBERS}


class Atom(str):
    """A name. Equal to the str of the same letters, and written as an atom."""

    __slots__ = ()

    def __repr__(self):
        return f"Atom({str(self)!r})"


class Struct(dict):
    """A struct of Elixir's: its fields by name, also as attributes."""

    def __init__(self, module, fields=()):
        super().__init__(fields)
        self.module = module

    def __getattr__(self, name):
        try:
            return self[name]
        except KeyError:
            raise AttributeError(name) from None

    def __repr__(self):
        return f"Struct({self.module!r}, {dict(self)!r})"


def decode(data):
    """The term in `data`. Functions, processes and compressed terms are refused (`Damaged`)."""
    cursor = Cursor(data)
    if cursor.take(1)[0] != _VERSION:
        raise Damaged("a term does not begin with 131")
    term = _read(cursor, 0, False)
    if cursor.at != len(data):
        raise Damaged("a term ends before its bytes")
    return term


def _read(cursor, depth, key):
    if depth > DEEPEST:
        raise Damaged("a term is nested too deeply")
    tag = cursor.take(1)[0]
    reader = _READERS.get(tag)
    if reader is None:
        raise Damaged(f"a term of the kind {tag}, which is no plain data")
    return reader(cursor, depth, key)


def _atom(layout):
    def read(cursor, _depth, key):
        name = _text(cursor.take(cursor.unpack(layout)[0]))
        return Atom(name) if key or name not in _WORDS else _WORDS[name]

    return read


def _text(raw):
    try:
        return bytes(raw).decode()
    except UnicodeDecodeError:
        return bytes(raw).decode("latin-1")


def _binary(cursor, _depth, _key):
    raw = bytes(cursor.take(cursor.unpack(">I")[0]))
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw


def _big(layout):
    def read(cursor, _depth, _key):
        length, sign = cursor.unpack(layout)
        value = int.from_bytes(cursor.take(length), "little")
        return -value if sign else value

    return read


def _several(cursor, count, depth, key=False):
    # Every element takes a byte at least: no memory is asked for that the bytes cannot fill.
    if count > len(cursor.data) - cursor.at:
        raise Damaged("a term has more elements than bytes")
    return [_read(cursor, depth + 1, key) for _ in range(count)]


def _list(cursor, depth, _key):
    elements = _several(cursor, cursor.unpack(">I")[0], depth)
    if _read(cursor, depth + 1, True) != []:
        raise Damaged("an improper list")
    return elements


def _map(cursor, depth, _key):
    (count,) = cursor.unpack(">I")
    if 2 * count > len(cursor.data) - cursor.at:
        raise Damaged("a term has more elements than bytes")
    fields, module = {}, None
    for _ in range(count):
        key = _read(cursor, depth + 1, True)
        if key == "__struct__" and isinstance(key, Atom):
            module = str(_read(cursor, depth + 1, True)).removeprefix("Elixir.")
            continue
        try:
            fields[key] = _read(cursor, depth + 1, False)
        except TypeError:
            # A list or a map as a key, which Python has not.
            fields[repr(key)] = _read(cursor, depth + 1, False)
    return Struct(module, fields) if module else fields


def _tuple(layout):
    return lambda cursor, depth, key: tuple(_several(cursor, cursor.unpack(layout)[0], depth, key))


def _number(layout):
    return lambda cursor, _depth, _key: cursor.unpack(layout)[0]


_READERS = {
    70: _number(">d"),
    97: _number(">B"),
    98: _number(">i"),
    100: _atom(">H"),
    104: _tuple(">B"),
    105: _tuple(">I"),
    106: lambda _cursor, _depth, _key: [],
    107: lambda cursor, _depth, _key: list(cursor.take(cursor.unpack(">H")[0])),
    108: _list,
    109: _binary,
    110: _big(">BB"),
    111: _big(">IB"),
    115: _atom(">B"),
    116: _map,
    118: _atom(">H"),
    119: _atom(">B"),
}


def encode(term):
    """A term as bytes. Raises TypeError for what is no plain data."""
    out = bytearray([_VERSION])
    _write(term, out, 0)
    return bytes(out)


def _write(term, out, depth):
    if depth > DEEPEST:
        raise TypeError("a term that is nested too deeply")
    if term is None or isinstance(term, (bool, Atom)):
        _write_atom({None: "nil", True: "true", False: "false"}.get(term, term) if not isinstance(term, Atom) else term, out)
    elif isinstance(term, int):
        _write_int(term, out)
    elif isinstance(term, float):
        _write_float(term, out)
    elif isinstance(term, (str, bytes, bytearray, memoryview)):
        raw = term.encode() if isinstance(term, str) else bytes(term)
        out += struct.pack(">BI", 109, len(raw)) + raw
    elif isinstance(term, dict):
        pairs = list(term.items())
        if isinstance(term, Struct):
            pairs = [(Atom("__struct__"), Atom("Elixir." + term.module)), *((Atom(key), value) for key, value in pairs)]
        out += struct.pack(">BI", 116, len(pairs))
        for key, value in pairs:
            _write(key, out, depth + 1)
            _write(value, out, depth + 1)
    elif isinstance(term, tuple):
        out += struct.pack(">BI", 105, len(term))
        for element in term:
            _write(element, out, depth + 1)
    elif isinstance(term, list):
        if term:
            out += struct.pack(">BI", 108, len(term))
            for element in term:
                _write(element, out, depth + 1)
        out.append(106)
    elif hasattr(term, "item") and getattr(term, "ndim", None) == 0:
        _write(term.item(), out, depth)
    else:
        raise TypeError(f"{type(term).__name__} is nothing that a message can hold here")


def _write_atom(name, out):
    raw = name.encode()
    if len(raw) > 255:
        raise TypeError("an atom of more than 255 letters")
    out += struct.pack(">BB", 119, len(raw)) + raw


def _write_int(value, out):
    if 0 <= value < 256:
        out += struct.pack(">BB", 97, value)
    elif -(1 << 31) <= value < 1 << 31:
        out += struct.pack(">Bi", 98, value)
    else:
        raw = abs(value).to_bytes((value.bit_length() + 7) // 8, "little")
        head = struct.pack(">BBB", 110, len(raw), value < 0) if len(raw) < 256 else struct.pack(">BIB", 111, len(raw), value < 0)
        out += head + raw


def _write_float(value, out):
    if math.isfinite(value):
        out += struct.pack(">Bd", 70, value)
    else:
        _write_atom("nan" if math.isnan(value) else "infinity" if value > 0 else "neg_infinity", out)
