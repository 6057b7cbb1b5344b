"""Reads and writes stores with the native core of Situ, if the extension module `situ_core` is installed.

Without it, `layout.StoreFiles` and `writer.Writer` do the same in Python. They also check the core in tests.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterable, Iterator
from typing import Any, Optional, Union

from . import terms
from .binary import BINARIES, CODEC, Damaged, Missing
from .layout import ChunkRange, DamageList, Found, StoreFiles, decode_text, parse_catalog
from .progress import Progress
from .values import import_numpy

_INTERFACE = 1
# The number of messages that are read without reporting progress.
_STEP = 1 << 20

try:
    native: Any = importlib.import_module("situ_core")
except ImportError:
    native = None


def is_installed() -> bool:
    """Returns whether the native core is installed, matches this package, and is not turned off.

    The environment variable `SITU_PYTHON_CORE=off` turns it off.
    """
    fits = native is not None and native.INTERFACE == _INTERFACE
    return fits and os.environ.get("SITU_PYTHON_CORE") != "off"


def select_core(core: Optional[bool]) -> bool:
    """Returns whether to use the core: as required, or else if it is installed. Raises `Missing`."""
    if core and not is_installed():
        raise Missing("the native core is not installed: pip install native/situ_store_py, in Situ's source code")
    return is_installed() if core is None else core


def open_files(path: str, core: Optional[bool]) -> Union[CoreFiles, StoreFiles]:
    """Opens the files of a store with the core, or without it."""
    if select_core(core):
        try:
            return CoreFiles(path)
        except Damaged:
            # The reader in Python accepts more damage in the header of an index, or has the better message.
            pass
    return StoreFiles(path)


class CoreFiles(DamageList):
    """The files of a store, read by the core. It has the methods of `layout.StoreFiles`."""

    def __init__(self, folder: str) -> None:
        super().__init__()
        self.folder = folder
        self._reader = native.Reader(folder)
        self.created: int = self._reader.created
        self._entries = self._listed = 0
        self.state = 0
        self.refresh()

    def refresh(self) -> bool:
        """Reads newly committed entries. Returns whether there were any."""
        # Once the store is closed, no more entries follow.
        self.state = int(self._reader.closed)
        before, self._entries = self._entries, self._reader.refresh()
        damage = self._reader.damage()
        for sentence in damage[self._listed :]:
            self.note_damage(sentence)
        self._listed = len(damage)
        return self._entries > before

    def is_abandoned(self) -> bool:
        """Returns whether the writer exited without closing the store."""
        return self.state != 1 and not self._reader.closed and not self._reader.is_live()

    def summarize_streams(self) -> dict[int, tuple[int, int, int]]:
        """Returns a dict from stream number to (message count, first time, last time) of streams with messages."""
        return {id: (count, first, last) for id, count, first, last in self._reader.streams()}

    def get_chunk(self, id: int, position: int) -> Optional[ChunkRange]:
        """Returns the `ChunkRange` of a stream at a position, which is the ordinal of a message, or None."""
        found = self._reader.chunk(id, position)
        return None if found is None else ChunkRange(*found)

    def find_chunk(self, id: int, time: int) -> Optional[ChunkRange]:
        """Returns the first chunk of a stream that ends at or after a time, or None."""
        found = self._reader.find_chunk(id, time)
        return None if found is None else ChunkRange(*found)

    def read_rows(self, id: int, chunk: ChunkRange, text: bool) -> tuple[int, int, Iterable[tuple[int, int, int, Any]]]:
        """Returns the encoding of a chunk, its codec, and its messages: (time, creation, sequence, data)."""
        encoding, codec, rows, error = self._reader.messages(id, chunk.position, text)
        if chunk.large:
            load = _view_payload if encoding == CODEC else bytes
            rows = [(*row[:3], load(row[3]) if isinstance(row[3], native.Payload) else row[3]) for row in rows]
            if encoding == BINARIES and text:
                rows = [(*row[:3], decode_text(row[3])) for row in rows]
        return encoding, codec, rows if error is None else _raise_after(rows, error)

    def read_arrays(self, np: Any, id: int, start: Optional[int], stop: Optional[int]) -> Iterator[tuple[float, Found]]:
        """Yields a stream as arrays of times (int64) and numbers: (the part that was read so far, `Found`)."""
        reader, done = self._reader.columns(id, start, stop), 0.0
        while done < 1:
            done = reader.step(_STEP)
            yield done, Found()
        for found in reader.take():
            if isinstance(found, int):
                yield done, Found(chunk=self.get_chunk(id, found))
            elif isinstance(found[1], Exception):
                yield done, Found(chunk=self.get_chunk(id, found[0]), error=found[1])
            else:
                yield done, Found(np.asarray(found[0]), np.asarray(found[1]))

    def read_table(
        self, np: Any, id: int, start: Optional[int], stop: Optional[int], report: Progress
    ) -> Optional[tuple[dict[str, Any], list[tuple[int, Exception]]]]:
        """Reads a stream of maps: its columns, and the damage that was left out. None if the messages are no table."""
        reader, done = self._reader.table(id, start, stop), 0.0
        while done < 1:
            done = reader.step(_STEP // 8)
            report(done)
        found = reader.take()
        if found is None:
            return None
        columns = {"time": np.asarray(found[0]).view("M8[ns]")}
        for name, column in found[1]:
            columns[name] = _select_objects(np, *column) if isinstance(column, tuple) else np.asarray(column)
        return columns, found[2]

    def read_catalog(self) -> Any:
        """Returns the store's record, and a dict from stream number to the stream's records."""
        return parse_catalog(self._iterate_catalog())

    def _iterate_catalog(self) -> Iterator[Any]:
        chunk = self.get_chunk(0, 0)
        while chunk is not None:
            try:
                for row in self.read_rows(0, chunk, False)[2]:
                    yield bytes(row[3])
            except Damaged as error:
                # Chunks after a damaged chunk of the catalog are still usable.
                self.note_damage(f"the catalog: {error}")
            chunk = self.get_chunk(0, chunk.next)


def _select_objects(np: Any, codes: Any, encoded: list[bytes]) -> Any:
    objects = np.empty(len(encoded), object)
    for code, term in enumerate(encoded):
        objects[code] = terms.decode_term(b"\x83" + term)
    return objects[np.asarray(codes)]


def _raise_after(rows: list[Any], error: Exception) -> Iterator[Any]:
    yield from rows
    raise error


def _view_payload(data: Any) -> Any:
    """Returns a large payload as a view of the mapped file if numpy is installed, otherwise as bytes."""
    try:
        numpy = import_numpy()
    except Missing:
        return bytes(data)
    return memoryview(numpy.asarray(data))
