"""Shows the progress of long operations on a terminal and in notebooks."""

from __future__ import annotations

import sys
import time
from typing import Optional

# Short operations show nothing.
_QUIET_SECONDS = 0.5
_INTERVAL = 0.1


class Progress:
    """Shows a line like `Reading Level: 42 %` while a `with` block is running. Call it with the part that is done.

    Without `shown`, it is shown if the standard error output is a terminal, and in notebooks.
    """

    def __init__(self, label: str, shown: Optional[bool] = None) -> None:
        self._label = label
        self._shown = _is_watched() if shown is None else shown
        self._next = time.monotonic() + _QUIET_SECONDS
        self._length = 0

    def __enter__(self) -> Progress:
        return self

    def __call__(self, done: float) -> None:
        if not self._shown or time.monotonic() < self._next:
            return
        self._next = time.monotonic() + _INTERVAL
        self._write(f"{self._label}: {int(100 * done)} %")

    def __exit__(self, *_: object) -> None:
        if self._length:
            self._write("")
            sys.stderr.write("\r")
            sys.stderr.flush()

    def _write(self, text: str) -> None:
        sys.stderr.write("\r" + text.ljust(self._length))
        sys.stderr.flush()
        self._length = len(text)


def _is_watched() -> bool:
    """Returns whether somebody watches the output: it is a terminal, or that of a notebook."""
    return "ipykernel" in sys.modules or bool(sys.stderr and sys.stderr.isatty())
