"""Large messages in frames, which are read when they are used."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .layout import ChunkRange
    from .reader import Store


class Lazy:
    """A message of 32 KiB or more in a column of a `Frame`, for example an image. It is read when it is used.

    It has the attributes of its value (`frame["Camera"][5].array`), which `load` returns. Nothing is kept in memory.
    Damage raises `Damaged` at this moment.
    """

    __slots__ = ("_chunk", "_name", "_store", "time")

    def __init__(self, store: Store, name: str, chunk: ChunkRange) -> None:
        self._store, self._name, self._chunk = store, name, chunk
        self.time = chunk.first
        """The message's originating time, ns."""

    def load(self) -> Any:
        """Reads the value."""
        return next(self._store._read_chunk(self._name, self._chunk)).data

    @property
    def type_name(self) -> str:
        """The type of the stream, in Elixir's notation."""
        return self._store.streams[self._name].type

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            # Numpy looks for its own protocols, which must not read the message.
            raise AttributeError(name)
        return getattr(self.load(), name)

    def __repr__(self) -> str:
        return f"<situ.Lazy message of {self._name!r} at {self.time}>"
