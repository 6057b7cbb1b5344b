"""Encodes and decodes Erlang's external term format, which stores messages that have no binary layout.

| Erlang, Elixir | Python |
|---|---|
| integer, float, list, tuple, map | int, float, list, tuple, dict |
| `true`, `false`, `nil` | True, False, None |
| `:nan`, `:infinity`, `:neg_infinity` (as values) | float |
| other atoms | `Atom`, a str |
| binary | str if it is UTF-8, otherwise bytes |
| struct | `Struct`, a dict with `.module`, whose fields are also attributes |
"""

from __future__ import annotations

import math
import struct
from typing import Any, Callable, Union

from .binary import Buffer, Cursor, Damaged

TermReader = Callable[[Cursor, int, bool], Any]

MAX_DEPTH = 512
_VERSION = 131
_FLOAT = struct.Struct(">BBd")
_INT = struct.Struct(">BBi")
_FLOAT_ATOMS = {"nan": math.nan, "infinity": math.inf, "neg_infinity": -math.inf}
_ATOM_VALUES = {"true": True, "false": False, "nil": None, **_FLOAT_ATOMS}


class Atom(str):
    """An atom. It equals the str with the same characters, but is written as an atom."""

    __slots__ = ()

    def __repr__(self) -> str:
        return f"Atom({str(self)!r})"


class Struct(dict[Any, Any]):
    """An Elixir struct: a dict of its fields, which are also attributes."""

    def __init__(self, module: str, fields: Any = ()) -> None:
        super().__init__(fields)
        self.module = module

    def __getattr__(self, name: str) -> Any:
        try:
            return self[name]
        except KeyError:
            raise AttributeError(name) from None

    def __repr__(self) -> str:
        return f"Struct({self.module!r}, {dict(self)!r})"


def decode_term(data: Buffer) -> Any:
    """Decodes a term. Raises `Damaged`, also for functions, processes and compressed terms."""
    # Plain numbers are by far the most frequent terms.
    if len(data) == 10 and data[0] == _VERSION and data[1] == 70:
        return _FLOAT.unpack(data)[2]
    if len(data) == 6 and data[0] == _VERSION and data[1] == 98:
        return _INT.unpack(data)[2]
    cursor = Cursor(data)
    if cursor.read_bytes(1)[0] != _VERSION:
        raise Damaged("a term does not begin with byte 131")
    term = _read_term(cursor, 0, False)
    if cursor.position != len(data):
        raise Damaged("a term is followed by extra bytes")
    return term


def _read_term(cursor: Cursor, depth: int, key: bool) -> Any:
    if depth > MAX_DEPTH:
        raise Damaged(f"a term is nested more than {MAX_DEPTH} levels deep")
    tag = cursor.read_bytes(1)[0]
    reader = _READERS.get(tag)
    if reader is None:
        raise Damaged(f"a term has the tag {tag}, which is not plain data")
    return reader(cursor, depth, key)


def _build_atom_reader(layout: str) -> TermReader:
    def read_atom(cursor: Cursor, _depth: int, key: bool) -> Any:
        name = _decode_text(cursor.read_bytes(cursor.read_struct(layout)[0]))
        return Atom(name) if key or name not in _ATOM_VALUES else _ATOM_VALUES[name]

    return read_atom


def _decode_text(raw: Buffer) -> str:
    try:
        return bytes(raw).decode()
    except UnicodeDecodeError:
        return bytes(raw).decode("latin-1")


def _read_binary(cursor: Cursor, _depth: int, _key: bool) -> Union[str, bytes]:
    raw = bytes(cursor.read_bytes(cursor.read_struct(">I")[0]))
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw


def _build_bignum_reader(layout: str) -> TermReader:
    def read_bignum(cursor: Cursor, _depth: int, _key: bool) -> int:
        length, sign = cursor.read_struct(layout)
        value = int.from_bytes(cursor.read_bytes(length), "little")
        return -value if sign else value

    return read_bignum


def _read_elements(cursor: Cursor, count: int, depth: int, key: bool = False) -> list[Any]:
    # Every element takes at least one byte, so this check limits the memory that a forged count can allocate.
    if count > len(cursor.data) - cursor.position:
        raise Damaged("a term has more elements than bytes")
    return [_read_term(cursor, depth + 1, key) for _ in range(count)]


def _read_list(cursor: Cursor, depth: int, _key: bool) -> list[Any]:
    elements = _read_elements(cursor, cursor.read_struct(">I")[0], depth)
    if _read_term(cursor, depth + 1, True) != []:
        raise Damaged("a term contains an improper list")
    return elements


def _read_map(cursor: Cursor, depth: int, _key: bool) -> Any:
    (count,) = cursor.read_struct(">I")
    if 2 * count > len(cursor.data) - cursor.position:
        raise Damaged("a term has more elements than bytes")
    fields, module = {}, None
    for _ in range(count):
        key = _read_term(cursor, depth + 1, True)
        if key == "__struct__" and isinstance(key, Atom):
            module = str(_read_term(cursor, depth + 1, True)).removeprefix("Elixir.")
            continue
        try:
            fields[key] = _read_term(cursor, depth + 1, False)
        except TypeError:
            # Python's dicts do not support lists and maps as keys.
            fields[repr(key)] = _read_term(cursor, depth + 1, False)
    return Struct(module, fields) if module else fields


def _build_tuple_reader(layout: str) -> TermReader:
    return lambda cursor, depth, key: tuple(_read_elements(cursor, cursor.read_struct(layout)[0], depth, key))


def _build_number_reader(layout: str) -> TermReader:
    return lambda cursor, _depth, _key: cursor.read_struct(layout)[0]


_READERS = {
    70: _build_number_reader(">d"),
    97: _build_number_reader(">B"),
    98: _build_number_reader(">i"),
    100: _build_atom_reader(">H"),
    104: _build_tuple_reader(">B"),
    105: _build_tuple_reader(">I"),
    106: lambda _cursor, _depth, _key: [],
    107: lambda cursor, _depth, _key: list(cursor.read_bytes(cursor.read_struct(">H")[0])),
    108: _read_list,
    109: _read_binary,
    110: _build_bignum_reader(">BB"),
    111: _build_bignum_reader(">IB"),
    115: _build_atom_reader(">B"),
    116: _read_map,
    118: _build_atom_reader(">H"),
    119: _build_atom_reader(">B"),
}


def encode_term(term: Any) -> bytes:
    """Encodes a term. Raises TypeError for values that are not plain data."""
    kind = type(term)
    if kind is float and math.isfinite(term):
        return _FLOAT.pack(_VERSION, 70, term)
    if kind is int and 256 <= term < 1 << 31:
        return _INT.pack(_VERSION, 98, term)
    out = bytearray([_VERSION])
    _write_term(term, out, 0)
    return bytes(out)


def _write_term(term: Any, out: bytearray, depth: int) -> None:
    if depth > MAX_DEPTH:
        raise TypeError(f"cannot encode a value that is nested more than {MAX_DEPTH} levels deep")
    if isinstance(term, Atom):
        _write_atom(term, out)
    elif term is None or isinstance(term, bool):
        _write_atom({None: "nil", True: "true", False: "false"}[term], out)
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
            _write_term(key, out, depth + 1)
            _write_term(value, out, depth + 1)
    elif isinstance(term, tuple):
        out += struct.pack(">BI", 105, len(term))
        for element in term:
            _write_term(element, out, depth + 1)
    elif isinstance(term, list):
        if term:
            out += struct.pack(">BI", 108, len(term))
            for element in term:
                _write_term(element, out, depth + 1)
        out.append(106)
    elif hasattr(term, "item") and getattr(term, "ndim", None) == 0:
        _write_term(term.item(), out, depth)
    else:
        raise TypeError(f"cannot encode a {type(term).__name__}: use numbers, str, bytes, None, list, tuple or dict")


def _write_atom(name: str, out: bytearray) -> None:
    raw = name.encode()
    if len(raw) > 255:
        raise TypeError(f"cannot encode an atom of {len(raw)} bytes: the maximum is 255")
    out += struct.pack(">BB", 119, len(raw)) + raw


def _write_int(value: int, out: bytearray) -> None:
    if 0 <= value < 256:
        out += struct.pack(">BB", 97, value)
    elif -(1 << 31) <= value < 1 << 31:
        out += struct.pack(">Bi", 98, value)
    else:
        raw = abs(value).to_bytes((value.bit_length() + 7) // 8, "little")
        layout, tag = (">BBB", 110) if len(raw) < 256 else (">BIB", 111)
        out += struct.pack(layout, tag, len(raw), value < 0) + raw


def _write_float(value: float, out: bytearray) -> None:
    if math.isfinite(value):
        out += struct.pack(">Bd", 70, value)
    else:
        _write_atom("nan" if math.isnan(value) else "infinity" if value > 0 else "neg_infinity", out)
