"""Components of a Situ pipeline that are written in Python; `Situ.Python.component` starts them.

    import situ

    class Detector(situ.Component):
        def setup(self, threshold):
            self.threshold = threshold

        def on_image(self, image, message):
            return {"brightness": float(image.array.mean()), "bright": image.array.mean() > self.threshold}

Situ runs each component in a process of its own, and restarts it as its `on_error:` demands.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Optional, Union

from . import shared_memory
from .values import import_numpy


class Envelope(NamedTuple):
    """The facts about a message: its times (nanoseconds since 1970), sequence number and input."""

    time: int
    creation: int
    sequence: int
    input: str


class Component:
    """Base class of components.

    A component defines `on_NAME(self, value, message)` for each input NAME, or `on_message(self, value, message)` for
    all inputs. `value` is the data, and `message` its `Envelope`. Images, audio, tensors and clouds refer to memory
    that is shared with Situ: their arrays are not copies and cannot be written to.

    A handler returns None, a dict with values for outputs, or a list of results. Each result is a dict, or a tuple of
    a time (nanoseconds) and a dict. Without a time, values get the time of the message.

    With the option `batch: n`, the component defines `on_batch(self, values, messages)` instead. It receives up to n
    values at once, and returns a list with one such result for each.

    A source defines `produce(self)` instead, a generator of such results. Without a time, they get the time at which
    they are yielded.
    """

    outputs: dict[str, str] = {"out": "any"}
    """The names and types of the outputs, for `situ run`."""

    _memory: Optional[shared_memory.OutputSlots] = None

    def empty(self, shape: Union[int, tuple[int, ...]], dtype: Any = "uint8") -> Any:
        """Returns a new numpy array, not initialized, like `numpy.empty`.

        A large array is in the memory that is shared with Situ, so returning it takes no copy. It cannot be written to
        afterwards.
        """
        numpy = import_numpy()
        dtype = numpy.dtype(dtype)
        size = int(numpy.prod(shape, dtype=object)) * dtype.itemsize
        view = self._memory.lend(size) if self._memory and size >= shared_memory.LARGE else None
        return numpy.empty(shape, dtype) if view is None else numpy.frombuffer(view, dtype).reshape(shape)

    def setup(self, *positional: Any, **options: Any) -> None:
        """Prepares the component before its first message; receives the options as keyword arguments.

        The parameters of this method have no meaning: they allow type checkers to accept those of yours.
        """
        if options:
            raise TypeError(f"{type(self).__name__} has no method setup, so it takes no options: {sorted(options)}")

    def on_close(self, time: int) -> Any:
        """Handles the end of all inputs at `time`; returns results like a handler."""

    def snapshot(self) -> Any:
        """Returns the state of the component for a checkpoint: plain data, an array, or bytes."""
        raise NotImplementedError(f"{type(self).__name__} has no method snapshot")

    def restore(self, data: Any) -> None:
        """Restores the state that `snapshot` returned, after `setup`."""
        raise NotImplementedError(f"{type(self).__name__} has no method restore")


def start_generator(component: Any) -> Iterator[Any]:
    """Returns the values of a source. Raises TypeError if the component is not one."""
    if not callable(getattr(component, "produce", None)):
        raise TypeError(f"{type(component).__name__} is not a source: define produce(self), a generator of results")
    return iter(component.produce())


def describe_class(kind: type[Component]) -> dict[str, Any]:
    """Describes a class of components as plain data."""
    names = [name[3:] for name in dir(kind) if name.startswith("on_") and callable(getattr(kind, name))]
    options = []
    for parameter in list(inspect.signature(kind.setup).parameters.values())[1:]:
        if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            default = None if parameter.default is parameter.empty else repr(parameter.default)
            options.append({"name": parameter.name, "default": default})
    return {
        "name": kind.__name__,
        "generates": callable(getattr(kind, "produce", None)),
        "inputs": [name for name in names if name != "close"],
        "outputs": [[name, str(kind.outputs[name])] for name in kind.outputs],
        "options": options,
    }


def find_handlers(component: Component, inputs: list[str], batch: int = 1) -> list[Callable[..., Any]]:
    """Returns the handler of each input; none with batches. Raises TypeError if one is missing."""
    if batch > 1:
        if not callable(getattr(component, "on_batch", None)):
            raise TypeError(f"{type(component).__name__} handles no batches: define on_batch(self, values, messages)")
        return []
    handlers = []
    for name in inputs:
        handler = getattr(component, f"on_{name}", None) or getattr(component, "on_message", None)
        if not callable(handler):
            kind = type(component).__name__
            defined = sorted(key for key in dir(component) if key.startswith("on_") and key != "on_close")
            raise TypeError(
                f"{kind} does not handle the input {name}: define on_{name}(self, value, message)"
                + (f"; it defines {', '.join(defined)}" if defined else "")
            )
        handlers.append(handler)
    return handlers


def list_results(returned: Any, time: int) -> list[tuple[int, dict[str, Any]]]:
    """Converts the return value of a handler to a list of (time, dict). Raises TypeError."""
    if returned is None:
        return []
    if isinstance(returned, dict):
        return [(time, returned)]
    if not isinstance(returned, list):
        what = f"the handler returned {_describe(returned)}"
        raise TypeError(f"{what}: return a dict of outputs, None, or a list of dicts")
    return [_check_result(result, time) for result in returned]


def _check_result(result: Any, time: int) -> tuple[int, dict[str, Any]]:
    if isinstance(result, dict):
        return time, result
    if isinstance(result, tuple) and len(result) == 2 and isinstance(result[1], dict):
        # bool is an int, and numpy integers are not.
        if hasattr(result[0], "__index__") and not isinstance(result[0], bool):
            return result[0].__index__(), result[1]
    what = f"the list contains {_describe(result)}"
    raise TypeError(f"{what}: each result is a dict, or a tuple of a time (int) and a dict")


def _describe(value: Any) -> str:
    text = repr(value)
    return f"a {type(value).__name__}, {text if len(text) <= 60 else text[:57] + '...'}"
