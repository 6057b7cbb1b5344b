"""Memory that a component shares with Situ: files of slots, for values that are too large for the socket."""

from __future__ import annotations

import ctypes
import mmap
import os
import struct
import sys
from collections.abc import Iterable
from typing import Any, Optional

from .binary import Damaged

PAGE = 4_096
# A slot, the offset and capacity of its part for a value, and the length of the value, in bytes.
Place = tuple[int, int, int, int]
# Values of this size or larger go through shared memory.
LARGE = 1 << 16


class InputSlots:
    """Slots that Situ fills. A slot is in use until no value in Python refers to it."""

    def __init__(self, path: Any) -> None:
        self._file = os.open(path, os.O_RDONLY)
        self._maps: dict[int, mmap.mmap] = {}
        self._used: set[int] = set()

    def view(self, slot: int, offset: int, capacity: int, length: int) -> memoryview:
        """Returns the bytes of a slot as a read-only memoryview."""
        if slot not in self._maps:
            if offset % PAGE or os.fstat(self._file).st_size < offset + capacity:
                raise Damaged(f"slot {slot} ({capacity} bytes at {offset}) is outside of the shared memory")
            self._maps[slot] = mmap.mmap(self._file, capacity, access=mmap.ACCESS_READ, offset=offset)
        memory = self._maps[slot]
        if not 0 < length <= len(memory):
            raise Damaged(f"slot {slot} has {len(memory)} bytes, not {length}")
        self._used.add(slot)
        return memoryview(memory)[:length]

    def release(self) -> list[int]:
        """Returns the slots that are no longer in use."""
        # A view holds a reference to its map. The others are the dict and the argument of getrefcount.
        free = [slot for slot in self._used if sys.getrefcount(self._maps[slot]) <= 2]
        self._used.difference_update(free)
        return free


class OutputSlots:
    """Slots that Python fills, and that Situ returns after reading. Slots are added up to `limit` bytes.

    A slot can be lent to an array. It is in use until it was read, and nothing in Python refers to it any more. The
    page before the array has room for the header of its value.
    """

    def __init__(self, path: Any, limit: int) -> None:
        self._file = os.open(path, os.O_RDWR)
        self._limit, self._size = limit, 0
        self._slots: list[tuple[int, int, mmap.mmap, int]] = []
        self._free: list[int] = []
        # Slots that Situ does not read, but that arrays may refer to.
        self._lent: set[int] = set()

    def write(self, parts: list[memoryview]) -> Optional[Place]:
        """Copies buffers into a slot; returns (slot, offset, capacity, length), or None if there is no room."""
        length = sum(part.nbytes for part in parts)
        lent = self._find_lent(parts, length) if self._lent else None
        if lent:
            return lent
        slot = self._take_slot(length)
        if slot is None:
            return None
        offset, capacity, memory, _ = self._slots[slot]
        _copy_parts(memory, 0, parts)
        return slot, offset, capacity, length

    def lend(self, length: int) -> Optional[memoryview]:
        """Returns memory of a slot for an array, as a memoryview, or None if there is no room."""
        slot = self._take_slot(PAGE + length)
        if slot is None:
            return None
        self._lent.add(slot)
        return memoryview(self._slots[slot][2])[PAGE : PAGE + length]

    def give_back(self, slots: Iterable[int]) -> None:
        """Marks slots as read. They are free if no array refers to them."""
        self._lent.update(slots)

    def _find_lent(self, parts: list[memoryview], length: int) -> Optional[Place]:
        """Writes the header before an array that is in a slot; returns the place, or None for other values."""
        array: Any = getattr(parts[-1], "obj", None)
        head = length - parts[-1].nbytes
        if not hasattr(array, "__array_interface__") or head > PAGE:
            return None
        address, _read_only = array.__array_interface__["data"]
        for slot in self._lent:
            offset, capacity, memory, start = self._slots[slot]
            if address == start + PAGE and parts[-1].nbytes <= capacity - PAGE:
                _copy_parts(memory, PAGE - head, parts[:-1])
                array.flags.writeable = False
                self._lent.remove(slot)
                return slot, offset + PAGE - head, capacity - PAGE + head, length
        return None

    def _take_slot(self, length: int) -> Optional[int]:
        self._free_unused()
        for index in range(len(self._free) - 1, -1, -1):
            if self._slots[self._free[index]][1] >= length:
                return self._free.pop(index)
        return self._add_slot(-(-length // PAGE) * PAGE)

    def _free_unused(self) -> None:
        # An array holds a reference to its map. The others are the list of slots and the argument of getrefcount.
        unused = [slot for slot in self._lent if sys.getrefcount(self._slots[slot][2]) <= 2]
        self._lent.difference_update(unused)
        self._free.extend(unused)

    def _add_slot(self, capacity: int) -> Optional[int]:
        if self._size + capacity > self._limit:
            return None
        try:
            _reserve(self._file, self._size, capacity)
            memory = mmap.mmap(self._file, capacity, offset=self._size)
        except (OSError, ValueError):
            return None
        # Exporting the address must not keep a reference to the map.
        start = ctypes.addressof(ctypes.c_char.from_buffer(memory))
        self._slots.append((self._size, capacity, memory, start))
        self._size += capacity
        return len(self._slots) - 1


def _copy_parts(memory: Any, position: int, parts: list[memoryview]) -> None:
    for part in parts:
        memory[position : position + part.nbytes] = part
        position += part.nbytes


def _reserve(file: int, offset: int, size: int) -> None:
    """Makes a file longer. Writing to the map of a file system without room for it would end the process."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file, offset, size)
    else:
        os.ftruncate(file, offset + size)


class Journal:
    """The last results. They outlive this process: if it ends, Situ reads here the results that it did not receive.

    The file begins with the number of results before these, and the length of these.
    """

    HEAD = struct.Struct("<QQ")
    # No more messages are in flight, so older results have arrived.
    RESULTS = 1_000

    def __init__(self, path: Any) -> None:
        with open(path, "r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        self._before = 0
        self._ends = [self.HEAD.size]
        self._sent = self.HEAD.size

    def append(self, result: bytes) -> bool:
        """Appends a result; returns False if it does not fit. All others must have been sent if it is large."""
        start = self._ends[-1]
        if start + len(result) > len(self._memory):
            if self._sent < start or len(result) > len(self._memory) // 2 - self.HEAD.size:
                return False
            self._drop_results()
            start = self._ends[-1]
        self._memory[start : start + len(result)] = result
        self._ends.append(start + len(result))
        self._write_head()
        return True

    def take_unsent(self) -> bytes:
        """Returns the results since the last call, as one sequence of bytes."""
        unsent, self._sent = self._memory[self._sent : self._ends[-1]], self._ends[-1]
        return unsent

    def skip_result(self) -> None:
        """Counts a result that was sent, but does not fit."""
        self._before, self._ends, self._sent = self._before + len(self._ends), [self.HEAD.size], self.HEAD.size
        self._write_head()

    def _drop_results(self) -> None:
        """Keeps the last results, as far as half of the memory has room for them."""
        last, room = self._ends[-1], len(self._memory) // 2
        first = max(len(self._ends) - 1 - self.RESULTS, 0)
        while last - self._ends[first] > room - self.HEAD.size:
            first += 1
        shift = self._ends[first] - self.HEAD.size
        # While the results move, there are none.
        self.HEAD.pack_into(self._memory, 0, self._before + len(self._ends) - 1, 0)
        self._memory.move(self.HEAD.size, self._ends[first], last - self._ends[first])
        self._before += first
        self._ends = [end - shift for end in self._ends[first:]]
        self._sent = self._ends[-1]
        self._write_head()

    def _write_head(self) -> None:
        self.HEAD.pack_into(self._memory, 0, self._before, self._ends[-1] - self.HEAD.size)
