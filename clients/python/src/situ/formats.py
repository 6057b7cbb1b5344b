"""One message as bytes: the formats of `Situ.Bridge.Format`, by the same names."""

import json
import math
import struct

from . import terms, values
from .bytes import Damaged, Missing
from .times import from_text, from_ticks, to_text, to_ticks


def encode(format, time, data):
    """
    >>> encode("json", 0, {"x": 1.5})
    b'{"originatingTime": "1970-01-01T00:00:00.000000000Z", "message": {"x": 1.5}}'
    """
    return _module(format)[0](time, data)


def decode(format, raw, arrival):
    """The time and the value of a message; `Damaged` for what is none."""
    try:
        return _module(format)[1](raw, arrival)
    except (Damaged, Missing):
        raise
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise Damaged(f"{len(raw)} bytes are no {format} message: {error}") from error


def _module(format):
    if format not in _FORMATS:
        raise ValueError(f"no format {format!r}; there are {sorted(_FORMATS)}")
    return _FORMATS[format]


def _plain(value):
    """Arrays and numbers of numpy's as lists and numbers."""
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, dict):
        return {str(key): _plain(element) for key, element in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(element) for element in value]
    return value


def _words(value):
    """JSON has no NaN and infinities: Situ writes them as texts."""
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if isinstance(value, dict):
        return {key: _words(element) for key, element in value.items()}
    if isinstance(value, list):
        return [_words(element) for element in value]
    return value


def _to_json(time, data):
    return json.dumps({"originatingTime": to_text(time), "message": _words(_plain(data))}, allow_nan=False).encode()


def _from_json(raw, _arrival):
    document = json.loads(raw)
    return from_text(document["originatingTime"]), document["message"]


def _msgpack():
    try:
        import msgpack
    except ImportError:
        raise Missing("msgpack: pip install situ[msgpack]") from None
    return msgpack


def _to_message_pack(time, data):
    # Nanoseconds that no tick tells stand beside it.
    fine = {"nanoseconds": time % 100} if time % 100 else {}
    return _msgpack().packb({"message": _plain(data), "originatingTime": to_ticks(time), **fine})


def _from_message_pack(raw, _arrival):
    document = _msgpack().unpackb(raw)
    return from_ticks(document["originatingTime"]) + document.get("nanoseconds", 0), document["message"]


def _to_situ(time, data):
    data = values.coded(data)
    codec = values.codec(data)
    name, payload = (codec.NAME.encode(), data.encode()) if codec else (b"", terms.encode(data))
    return struct.pack("<qB", time, len(name)) + name + payload


def _from_situ(raw, _arrival):
    if len(raw) < 9 or len(raw) < 9 + raw[8]:
        raise Damaged("a message is too short")
    name, payload = raw[9 : 9 + raw[8]].decode(), raw[9 + raw[8] :]
    value = values.decode(name, payload) if name else terms.decode(payload)
    return struct.unpack_from("<q", raw)[0], value


_FORMATS = {
    "json": (_to_json, _from_json),
    "message_pack": (_to_message_pack, _from_message_pack),
    "situ": (_to_situ, _from_situ),
    "raw": (lambda _time, data: bytes(data), lambda raw, arrival: (arrival, raw)),
}
