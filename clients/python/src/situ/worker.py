"""The program that runs one component. `Situ.Python.component` starts it with the path of a socket.

Situ and the worker exchange frames over a Unix socket: a length (32 bits, big-endian), a letter, and fields in
little-endian order. `Situ.Python.Protocol` is the counterpart and describes the frames.
"""

from __future__ import annotations

import faulthandler
import importlib
import importlib.util
import json
import logging
import os
import pathlib
import socket
import struct
import sys
import time as clock
import traceback
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Callable, Optional

from . import component, shared_memory, terms, times, values
from .binary import Buffer, Damaged, Missing

_MESSAGE = struct.Struct("<BqqQB")
_SLOT = struct.Struct("<IQQQ")
_LENGTH = struct.Struct("<I")
_EMISSION = struct.Struct("<BqB")
_RECEIVE = 1 << 18
# Results wait for others at most this long.
_FLUSH_NS = 1_000_000
if TYPE_CHECKING:
    _StreamHandler = logging.StreamHandler[Any]
else:
    _StreamHandler = logging.StreamHandler


class StartError(Exception):
    """The component cannot be started: a code for programs, and what, why and fix for people."""

    def __init__(self, code: str, what: str, why: Optional[str] = None, fix: Optional[str] = None) -> None:
        super().__init__(what)
        self.term = {"code": code, "what": what, "why": why, "fix": fix}


class Connection:
    """Reads and writes frames."""

    def __init__(self, path: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(path)
        self._received = bytearray()

    def read_frame(self) -> Optional[bytes]:
        """Returns the next frame, or None at the end of the connection."""
        while True:
            if len(self._received) >= 4:
                (length,) = struct.unpack_from(">I", self._received)
                if len(self._received) >= 4 + length:
                    frame = bytes(memoryview(self._received)[4 : 4 + length])
                    del self._received[: 4 + length]
                    return frame
            part = self._socket.recv(_RECEIVE)
            if not part:
                return None
            self._received += part

    def write_frame(self, *parts: Buffer) -> None:
        size = sum(len(part) for part in parts)
        self._socket.sendall(b"".join((struct.pack(">I", size), *parts)))

    def close(self) -> None:
        self._socket.close()


class Worker:
    """Calls the component for each message and returns its results."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._started = 0
        self._failed = False
        self._forked = False
        os.register_at_fork(after_in_child=self._leave_connection)

    def _leave_connection(self) -> None:
        """Leaves the messages to the parent, after a handler has forked."""
        self._connection.close()
        self._forked = True

    def start(self, term: dict[str, Any]) -> None:
        self._inputs, self._outputs = term["inputs"], {name: i for i, name in enumerate(term["outputs"])}
        self._image_outputs = {i for i, kind in enumerate(term["types"]) if kind == "Situ.Image"}
        self._stops, self._batch = term["on_error"] != "skip", term["batch"]
        self._generates = term["generates"]
        if term["memory"]:
            _limit_memory(term["memory"])
        folder = pathlib.Path(term["folder"])
        self._slots = shared_memory.InputSlots(folder / "in")
        self._out = shared_memory.OutputSlots(folder / "out", term["shared"])
        self._journal = shared_memory.Journal(folder / "journal")
        kind = _load_class(term["source"], term["class"])
        self._component: Any = kind()
        self._component._memory = self._out
        options = {str(key): value for key, value in term["options"].items()}
        try:
            self._component.setup(**options)
        except Exception:
            raise StartError("python_failed", f"{kind.__name__}.setup failed", _format_exception()) from None
        try:
            if self._generates:
                self._values = component.start_generator(self._component)
                self._handlers = [self._generate]
            else:
                self._handlers = component.find_handlers(self._component, self._inputs, self._batch)
        except TypeError as error:
            raise StartError("bad_component", str(error)) from None
        version = ".".join(str(part) for part in sys.version_info[:3])
        self._connection.write_frame(b"O", _LENGTH.pack(os.getpid()), version.encode())

    def _generate(self, _value: Any, _envelope: Any) -> Any:
        return component.list_results(next(self._values), times.now())

    def run(self) -> None:
        """Handles frames until the connection ends."""
        while True:
            frame = self._connection.read_frame()
            if frame is None:
                return
            kind = frame[:1]
            if kind == b"M":
                self._handle_messages(frame)
            elif kind == b"R":
                self._out.give_back(slot for (slot,) in _LENGTH.iter_unpack(frame[1:]))
            elif kind == b"C":
                (time,) = struct.unpack_from("<q", frame, 1)
                self._connection.write_frame(b"D", self._call(self._component.on_close, time, time))
            elif kind == b"K":
                self._connection.write_frame(b"K", self._take_snapshot())
            elif kind == b"V":
                self._connection.write_frame(b"K", self._restore(frame[1:]))
            else:
                raise Damaged(f"unknown frame {kind!r}")

    def _handle_messages(self, frame: bytes) -> None:
        self._started = clock.monotonic_ns()
        messages = self._read_messages(frame)
        results = self._handle_batches(list(messages)) if self._batch > 1 else self._handle_each(messages)
        for result in results:
            self._add_result(result)
            # A generator may wait for the next value for any time.
            if self._failed or self._generates or clock.monotonic_ns() - self._started > _FLUSH_NS:
                self._flush()
            if self._failed:
                return
        self._flush()

    def _read_messages(self, frame: bytes) -> Iterator[Any]:
        """Yields the number of the input, the place of the value, and the envelope of each message."""
        position, size = 1, len(frame)
        while position < size:
            index, time, creation, sequence, shared = _MESSAGE.unpack_from(frame, position)
            position += _MESSAGE.size
            if shared:
                place: Any = _SLOT.unpack_from(frame, position)
                position += _SLOT.size
            else:
                (length,) = _LENGTH.unpack_from(frame, position)
                position += 4
                place = frame[position : position + length]
                position += length
            yield index, place, component.Envelope(time, creation, sequence, self._inputs[index])

    def _handle_each(self, messages: Any) -> Iterator[bytes]:
        for message in messages:
            if not self._failed:
                yield self._call(self._handle, message[2].time, *message)

    def _handle(self, index: int, place: Any, envelope: Any) -> Any:
        raw = place if isinstance(place, bytes) else self._slots.view(*place)
        return self._handlers[index](_decode_value(raw), envelope)

    def _handle_batches(self, messages: list[Any]) -> Iterator[bytes]:
        for start in range(0, len(messages), self._batch):
            batch = messages[start : start + self._batch]
            # If a batch fails, its messages are handled one by one, so that only the cause is lost.
            yield from self._call_batch(batch) or self._handle_each_alone(batch)

    def _handle_each_alone(self, batch: list[Any]) -> Iterator[bytes]:
        for message in batch:
            if not self._failed:
                yield self._call(lambda: self._handle_batch([message])[0], message[2].time)

    def _call_batch(self, batch: list[Any]) -> Optional[list[bytes]]:
        """Returns the encoded results of a batch, or None if it fails."""
        if len(batch) == 1:
            return None
        try:
            returned = self._handle_batch(batch)
            if self._forked:
                os._exit(0)
            lists = [component.list_results(result, message[2].time) for result, message in zip(returned, batch)]
            return [self._encode_results(results) for results in lists]
        except (Exception, SystemExit, KeyboardInterrupt):
            return None

    def _handle_batch(self, batch: list[Any]) -> Any:
        returned = self._component.on_batch([self._read_value(message[1]) for message in batch], [m[2] for m in batch])
        if not isinstance(returned, (list, tuple)) or len(returned) != len(batch):
            raise TypeError(f"on_batch must return a list with a result for each of the {len(batch)} values")
        return returned

    def _read_value(self, place: Any) -> Any:
        return _decode_value(place if isinstance(place, bytes) else self._slots.view(*place))

    def _call(self, function: Callable[..., Any], time: int, *arguments: Any) -> bytes:
        """Calls a function of the component; returns its encoded result."""
        try:
            returned = function(*arguments)
            if self._forked:
                os._exit(0)
            return self._encode_results(component.list_results(returned, time))
        except (Exception, SystemExit, KeyboardInterrupt) as error:
            if isinstance(error, StopIteration) and self._generates and function == self._handle:
                self._failed = True
                return b"\2"
            self._failed = self._stops
            return _encode_failure()

    def _encode_results(self, results: Any) -> bytes:
        emissions = [self._encode(time, name, value) for time, dict in results for name, value in dict.items()]
        return b"".join((b"\0", struct.pack("<H", len(emissions)), *emissions))

    def _take_snapshot(self) -> bytes:
        """Returns the encoded state of the component."""
        try:
            return b"\0" + struct.pack("<H", 1) + self._encode_emission(0, 0, self._component.snapshot())
        except Exception:
            return _encode_failure()

    def _restore(self, raw: Any) -> bytes:
        try:
            self._component.restore(_decode_value(raw))
            return b"\0" + struct.pack("<H", 0)
        except Exception:
            return _encode_failure()

    def _encode(self, time: int, name: str, value: Any) -> bytes:
        index = self._outputs.get(name)
        if index is None:
            raise TypeError(
                f"there is no output {name!r}: the outputs are {', '.join(self._outputs)}. "
                f"Declare it with `out:`, or for `situ run` in the class: outputs = {{{name!r}: 'any'}}"
            )
        if index in self._image_outputs and hasattr(value, "__array__"):
            value = values.Image.from_array(value, copy=False)
        return self._encode_emission(index, time, value)

    def _encode_emission(self, index: int, time: int, value: Any) -> bytes:
        if type(value) in (float, int):
            raw = terms.encode_term(value)
            return _EMISSION.pack(index, time, 0) + _LENGTH.pack(len(raw) + 1) + b"\0" + raw
        parts = _encode_value(value)
        length = sum(part.nbytes for part in parts)
        if length >= shared_memory.LARGE:
            place = self._out.write(parts)
            if place:
                return _EMISSION.pack(index, time, 1) + _SLOT.pack(*place)
        return b"".join((_EMISSION.pack(index, time, 0), _LENGTH.pack(length), *parts))

    def _add_result(self, result: bytes) -> None:
        if not self._journal.append(result):
            self._flush()
            if not self._journal.append(result):
                self._connection.write_frame(b"T", self._measure_spent(), result)
                self._journal.skip_result()

    def _flush(self) -> None:
        results = self._journal.take_unsent()
        if results:
            self._connection.write_frame(b"T", self._measure_spent(), results)
        free = self._slots.release()
        if free:
            self._connection.write_frame(b"L", *(_LENGTH.pack(slot) for slot in free))

    def _measure_spent(self) -> bytes:
        """Returns the encoded time since the last results, or since the frame has arrived."""
        started, self._started = self._started, clock.monotonic_ns()
        return struct.pack("<Q", self._started - started)


def _encode_failure() -> bytes:
    """Encodes the current exception."""
    text, fix = (part.encode(errors="replace") for part in (_format_exception(), _find_fix()))
    return b"".join((b"\1", _LENGTH.pack(len(text)), text, _LENGTH.pack(len(fix)), fix))


def _decode_value(raw: Any) -> Any:
    """Decodes a value in the format `"situ"` without its time (`situ.formats`)."""
    size = raw[0]
    payload = raw[1 + size :]
    if size:
        return values.decode_value(bytes(raw[1 : 1 + size]).decode(), payload)
    return terms.decode_term(payload)


def _encode_value(value: Any) -> list[memoryview]:
    """Encodes a value in the format `"situ"` without its time; returns memoryviews of bytes."""
    value = values.to_writable(value, copy=False)
    codec = values.find_codec(value)
    if codec:
        return [memoryview(bytes([len(codec.NAME)]) + codec.NAME.encode()), *values.encode_parts(value)]
    return [memoryview(b"\0" + terms.encode_term(value))]


def describe(source: str) -> None:
    """Prints the components of a file as JSON."""
    try:
        module = _load_file(source)
    except StartError as error:
        raise SystemExit("\n".join(part for part in (str(error), error.term["why"], error.term["fix"]) if part))
    kinds = [kind for kind in vars(module).values() if isinstance(kind, type) and kind.__module__ == module.__name__]
    described = [component.describe_class(kind) for kind in kinds if issubclass(kind, component.Component)]
    print("\n" + json.dumps(described))


def _load_class(source: str, name: str) -> type[component.Component]:
    module = _load_file(source) if source.endswith(".py") else _load_module(source)
    kind = getattr(module, name, None)
    if kind is None:
        found = ((key, value) for key, value in vars(module).items() if isinstance(value, type))
        classes = [key for key, value in found if value.__module__ == module.__name__]
        known = f"it defines {', '.join(classes)}" if classes else "it defines no class"
        raise StartError("no_python_class", f"{source} has no class {name}", known, f"write {source}:CLASS")
    if not (isinstance(kind, type) and issubclass(kind, component.Component)):
        what, why = f"{name} in {source} is not a component", "it does not inherit situ.Component"
        raise StartError("bad_component", what, why, f"write class {name}(situ.Component)")
    return kind


def _load_file(source: str) -> Any:
    path = pathlib.Path(source).resolve()
    sys.path[0:0] = [str(path.parent)]
    spec: Any = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    # Modules that refer to themselves (pickle, dataclasses) find the module here.
    sys.modules[path.stem] = module
    return _import(source, lambda: spec.loader.exec_module(module) or module)


def _load_module(source: str) -> Any:
    sys.path[0:0] = [os.getcwd()]
    return _import(source, lambda: importlib.import_module(source))


def _import(source: str, load: Callable[[], Any]) -> Any:
    try:
        return load()
    except ModuleNotFoundError as error:
        why = f"{sys.executable} has no module {error.name!r}"
        fix = _install_fix(error.name or "")
        raise StartError("no_python_module", f"{source} cannot be imported", why, fix) from None
    except (Exception, SystemExit):
        raise StartError("python_failed", f"{source} cannot be imported", _format_exception()) from None


def _format_exception() -> str:
    """Formats the current exception without the frames of this package at the beginning."""
    kind, error, trace = sys.exc_info()
    here = os.path.dirname(__file__) + os.sep
    while trace and trace.tb_next and trace.tb_frame.f_code.co_filename.startswith((here, "<frozen importlib")):
        trace = trace.tb_next
    return "".join(traceback.format_exception(kind, error, trace)).rstrip()


def _install_fix(module: str) -> str:
    # Debian's Python refuses pip, so the environment that Situ makes comes first.
    name = module.partition(".")[0]
    return f'add requirements: ["{name}"], or: {sys.executable} -m pip install {name}, or choose another python:'


def _find_fix() -> str:
    """Proposes how to fix the current exception, or returns an empty string."""
    error = sys.exc_info()[1]
    missing = "numpy" if isinstance(error, Missing) and "numpy" in str(error) else getattr(error, "name", None)
    if isinstance(error, (Missing, ModuleNotFoundError)) and missing:
        return _install_fix(missing)
    return "increase memory:" if isinstance(error, MemoryError) else ""


def _limit_memory(size: int) -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (size, size))


class _LogHandler(_StreamHandler):
    """Writes log records to standard error. Situ reads the level from the prefix, as journald does."""

    LEVELS = ((logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6), (0, 7))

    def format(self, record: logging.LogRecord) -> str:
        level = next(level for least, level in self.LEVELS if record.levelno >= least)
        return "\n".join(f"<{level}>{line}" for line in super().format(record).splitlines())


def main(path: str) -> None:
    # The group contains the processes that the component starts, so that all of them can be ended together.
    os.setpgid(0, 0)
    faulthandler.enable()
    handler = _LogHandler()
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    connection = Connection(path)
    worker = Worker(connection)
    try:
        worker.start(terms.decode_term((connection.read_frame() or b"")[1:]))
    except StartError as error:
        connection.write_frame(b"E", terms.encode_term(error.term))
        return
    worker.run()

