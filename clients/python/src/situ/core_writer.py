"""Writes stores with the native core."""

from __future__ import annotations

import json
from typing import Any, Optional

from . import core, terms, values
from .binary import CODEC, TERMS
from .times import now
from .writer import Writer, _check_time

_KINDS = {"i": ("i", "<i8"), "u": ("i", "<i8"), "f": ("f", "<f8"), "b": ("b", "?")}


class _CoreStream:
    """A stream: its number, and the numbers of its codecs."""

    def __init__(self, id: int) -> None:
        self.id = id
        self.codecs: dict[str, int] = {}


class CoreWriter(Writer):
    """The `Writer` that uses the native core."""

    def _open_files(self) -> None:
        self._core: Any = core.native.Writer(self.path)
        self._closed = False

    def write(self, name: str, time: int, data: Any, creation: Optional[int] = None) -> None:
        stream = self._streams.get(name)
        try:
            if stream is None or not self._core.write(stream.id, time, data, creation):
                self._write_other(name, time, data, creation)
        except ValueError as error:
            raise ValueError(f"stream {name!r}: {error}") from None

    write.__doc__ = Writer.write.__doc__

    def _write_other(self, name: str, time: int, data: Any, creation: Optional[int]) -> None:
        """Writes a message whose stream is new, or whose value is not a plain one."""
        time = _check_time(time)
        creation = max(now(), time) if creation is None else _check_time(creation)
        data = values.to_writable(data)
        stream = self._streams.get(name) or self._open_stream(name, data)
        if self._core.write(stream.id, time, data, creation):
            return
        codec = values.find_codec(data)
        if codec:
            kind = (CODEC, self._number_codec(stream, codec))
            parts = [bytes(part) for part in values.encode_parts(data)]
        else:
            kind, parts = (TERMS, 0), [terms.encode_term(data)]
        self._core.push(stream.id, kind, (time, creation), parts)

    def _write_columns(self, name: str, times: Any, values: Any, creations: Any) -> None:
        kind, layout = _KINDS.get(values.dtype.kind, (None, None))
        fits = values.ndim == 1 and kind is not None and not (values.dtype.kind == "u" and values.itemsize == 8)
        if not fits or (kind == "f" and not (values - values == 0).all()):
            return super()._write_columns(name, times, values, creations)
        stream = self._streams.get(name) or self._open_stream(name, values[0].item())
        later = b"" if creations is times else creations.tobytes()
        data = values.astype(layout, copy=False).tobytes()
        try:
            self._core.push_column(stream.id, kind, (times.astype("<i8", copy=False).tobytes(), later), data)
        except ValueError as error:
            raise ValueError(f"stream {name!r}: {error}") from None

    def _build_stream(self) -> _CoreStream:
        return _CoreStream(self._core.add_stream())

    def _add_record(self, record: dict[str, Any]) -> None:
        self._core.add_record(json.dumps(record).encode())

    def commit(self) -> None:
        self._core.commit()

    commit.__doc__ = Writer.commit.__doc__

    def close(self) -> None:
        if self._closed:
            return
        self.commit()
        for stream in self._streams.values():
            last = self._core.last_time(stream.id)
            if last is not None:
                self._add_record({"kind": "closed", "id": stream.id, "time": last})
        self._core.close()
        self._closed = True

    close.__doc__ = Writer.close.__doc__
