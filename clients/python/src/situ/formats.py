"""Encodes single messages as bytes, in the formats of `Situ.Bridge.Format` and with the same format names."""

from __future__ import annotations

import json
import math
import struct
from typing import Any, Callable

from . import terms, values
from .binary import Damaged, Missing
from .times import from_text, from_ticks, to_text, to_ticks


Encoder = Callable[[int, Any], bytes]
Decoder = Callable[[bytes, int], tuple[int, Any]]


def encode_message(format: str, time: int, data: Any) -> bytes:
    """
    Encodes a message.

    >>> encode_message("json", 0, {"x": 1.5})
    b'{"originatingTime": "1970-01-01T00:00:00.000000000Z", "message": {"x": 1.5}}'
    """
    return _find_codec(format)[0](time, data)


def decode_message(format: str, raw: bytes, arrival: int) -> tuple[int, Any]:
    """Returns the time and the value of an encoded message. Raises `Damaged` if the bytes are not a message."""
    try:
        return _find_codec(format)[1](raw, arrival)
    except (Damaged, Missing):
        raise
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise Damaged(f"{len(raw)} bytes are not a {format} message: {error}") from error


def _find_codec(format: str) -> tuple[Encoder, Decoder]:
    if format not in _FORMATS:
        raise ValueError(f"unknown format {format!r}; the formats are {sorted(_FORMATS)}")
    return _FORMATS[format]


def _to_plain(value: Any) -> Any:
    """Converts numpy arrays and numbers to lists and numbers, recursively."""
    if hasattr(value, "tolist"):
        return _to_plain(value.tolist())
    if isinstance(value, dict):
        return {str(key): _to_plain(element) for key, element in value.items()}
    if isinstance(value, (list, tuple)):
        return [_to_plain(element) for element in value]
    return value


def _replace_non_finite(value: Any) -> Any:
    """Replaces NaN and infinities by strings, as Situ does, because JSON cannot represent them."""
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if isinstance(value, dict):
        return {key: _replace_non_finite(element) for key, element in value.items()}
    if isinstance(value, list):
        return [_replace_non_finite(element) for element in value]
    return value


def _encode_json(time: int, data: Any) -> bytes:
    message = _replace_non_finite(_to_plain(data))
    return json.dumps({"originatingTime": to_text(time), "message": message}, allow_nan=False).encode()


def _decode_json(raw: bytes, _arrival: int) -> tuple[int, Any]:
    document = json.loads(raw)
    return from_text(document["originatingTime"]), document["message"]


def _import_msgpack() -> Any:
    try:
        import msgpack  # type: ignore[import-untyped, unused-ignore]
    except ImportError:
        raise Missing("msgpack is not installed: pip install situ[msgpack]") from None
    return msgpack


def _encode_message_pack(time: int, data: Any) -> bytes:
    # A tick is 100 ns, so the remaining nanoseconds are a separate member.
    fine = {"nanoseconds": time % 100} if time % 100 else {}
    packed: bytes = _import_msgpack().packb({"message": _to_plain(data), "originatingTime": to_ticks(time), **fine})
    return packed


def _decode_message_pack(raw: bytes, _arrival: int) -> tuple[int, Any]:
    document = _import_msgpack().unpackb(raw)
    return from_ticks(document["originatingTime"]) + document.get("nanoseconds", 0), document["message"]


def _encode_situ(time: int, data: Any) -> bytes:
    data = values.to_writable(data)
    codec = values.find_codec(data)
    name, payload = (codec.NAME.encode(), data.encode()) if codec else (b"", terms.encode_term(data))
    return struct.pack("<qB", time, len(name)) + name + payload


def _decode_situ(raw: bytes, _arrival: int) -> tuple[int, Any]:
    if len(raw) < 9 or len(raw) < 9 + raw[8]:
        raise Damaged("the message is too short")
    name, payload = raw[9 : 9 + raw[8]].decode(), raw[9 + raw[8] :]
    value = values.decode_value(name, payload) if name else terms.decode_term(payload)
    return struct.unpack_from("<q", raw)[0], value


_FORMATS = {
    "json": (_encode_json, _decode_json),
    "message_pack": (_encode_message_pack, _decode_message_pack),
    "situ": (_encode_situ, _decode_situ),
    "raw": (lambda _time, data: bytes(data), lambda raw, arrival: (arrival, raw)),
}
