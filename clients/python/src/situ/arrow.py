"""Describes columns of numpy arrays to the native core, which exports them through Arrow's C stream interface.

Numbers are not copied. See https://arrow.apache.org/docs/format/CDataInterface.html.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from . import core
from .binary import Missing
from .lazy import Lazy
from .values import import_numpy

Spec = tuple[str, str, int, int, list[Any], list[Any]]
_FORMATS = {"i1": "c", "i2": "s", "i4": "i", "i8": "l", "u1": "C", "u2": "S", "u4": "I", "u8": "L"}
_FORMATS.update({"f2": "e", "f4": "f", "f8": "g"})


def export_columns(columns: Mapping[str, Any]) -> Any:
    """Returns a PyCapsule `arrow_array_stream` with one table. Raises TypeError for other values than plain data."""
    if not core.is_installed():
        raise Missing("the native core is not installed: pip install native/situ_store_py, in Situ's source code")
    children = [describe_column(name, column) for name, column in columns.items()]
    rows = children[0][2] if children else 0
    return core.native.export_stream(("", "+s", rows, 0, [None], children))


def describe_column(name: str, column: Any) -> Spec:
    """Returns the description of a column: (name, format, length, null count, buffers, children)."""
    np = import_numpy()
    if column.ndim > 1:
        # The rows are lists of a fixed size.
        size = int(np.prod(column.shape[1:]))
        child = describe_column("item", np.ascontiguousarray(column).reshape(-1))
        return name, f"+w:{size}", len(column), 0, [None], [child]
    if column.dtype.kind == "M":
        return name, "tsn:UTC", len(column), 0, [None, np.ascontiguousarray(column).view("i8")], []
    if column.dtype.kind == "b":
        return name, "b", len(column), 0, [None, _pack_bits(np, column)], []
    format = _FORMATS.get(column.dtype.newbyteorder("<").str[1:])
    if format is not None:
        return name, format, len(column), 0, [None, np.ascontiguousarray(column, column.dtype.newbyteorder("<"))], []
    return _describe_objects(np, name, list(column))


def _pack_bits(np: Any, truths: Any) -> Any:
    return np.packbits(np.asarray(truths, "?"), bitorder="little")


def _describe_objects(np: Any, name: str, items: Sequence[Any]) -> Spec:
    kinds = {type(item) for item in items if item is not None}
    present = np.array([item is not None for item in items], "?")
    missing = len(items) - int(present.sum())
    validity = _pack_bits(np, present) if missing else None
    if not kinds:
        return name, "n", len(items), len(items), [], []
    if kinds == {bool}:
        values = _pack_bits(np, [bool(item) for item in items])
        return name, "b", len(items), missing, [validity, values], []
    if kinds <= {int, float}:
        values = np.array([item or 0 for item in items], "f8" if float in kinds else "i8")
        return name, "g" if float in kinds else "l", len(items), missing, [validity, values], []
    if all(issubclass(kind, str) for kind in kinds) or kinds <= {bytes, bytearray, memoryview}:
        is_text = all(issubclass(kind, str) for kind in kinds)
        raw = [b"" if item is None else item.encode("utf-8", "replace") if is_text else bytes(item) for item in items]
        ends = np.cumsum([0, *map(len, raw)], dtype="i8")
        values = np.frombuffer(b"".join(raw) or b"\0", "u1")
        return name, "U" if is_text else "Z", len(items), missing, [validity, ends, values], []
    if kinds <= {list, tuple}:
        inner = [element for item in items if item is not None for element in item]
        ends = np.cumsum([0, *(0 if item is None else len(item) for item in items)], dtype="i8")
        return name, "+L", len(items), missing, [validity, ends], [_describe_objects(np, "item", inner)]
    if all(issubclass(kind, dict) for kind in kinds):
        keys = dict.fromkeys(str(key) for item in items if item is not None for key in item)
        maps = [{str(key): value for key, value in (item or {}).items()} for item in items]
        children = [_describe_objects(np, key, [each.get(key) for each in maps]) for key in keys]
        return name, "+s", len(items), missing, [validity], children
    what = "large messages" if Lazy in kinds else " and ".join(sorted(kind.__name__ for kind in kinds))
    raise TypeError(f"Arrow cannot represent the column {name!r} of {what}: leave it out with `frame.select`")
