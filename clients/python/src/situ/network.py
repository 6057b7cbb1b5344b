"""Exchanges live streams over ZeroMQ; the counterpart of `Situ.Bridge.ZeroMQ`.

`format` is `"json"` (the default), `"message_pack"`, `"situ"` (any value, including images, audio and arrays) or
`"raw"`. Both sides must use the same format.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Optional

from . import formats
from .binary import Damaged, Missing
from .reader import Message
from .times import now

if TYPE_CHECKING:
    from typing_extensions import Self


def _import_zmq() -> Any:
    try:
        import zmq
    except ImportError:
        raise Missing("pyzmq is not installed: pip install situ[zeromq]") from None
    return zmq


def subscribe(
    address: str,
    topic: str = "",
    prefix: bool = False,
    format: str = "json",
    bind: bool = False,
    timeout: Optional[float] = None,
    high_water_mark: int = 1_000,
) -> _Receiver:
    """Returns an iterator over the messages of a topic.

    With `timeout` (seconds), it ends after that time without a message. With `prefix=True`, it yields the messages of
    all topics that begin with `topic`. Messages that cannot be decoded are skipped and counted in `unreadable`. Close
    the result with `close()` or use it in a `with` statement.
    """
    return _Receiver(_import_zmq().SUB, address, bind, format, timeout, high_water_mark, (topic, prefix))


def pull(
    address: str,
    format: str = "json",
    bind: bool = False,
    timeout: Optional[float] = None,
    high_water_mark: int = 1_000,
) -> _Receiver:
    """Returns an iterator over the messages of a PUSH socket, like `subscribe`."""
    return _Receiver(_import_zmq().PULL, address, bind, format, timeout, high_water_mark, None)


def publish(
    address: str,
    topic: str,
    format: str = "json",
    bind: bool = True,
    wait_for: int = 0,
    high_water_mark: int = 1_000,
    linger: float = 1.0,
) -> _Sender:
    """Returns a publisher with the method `send(time, data)`. The first `send` waits for `wait_for` subscribers."""
    return _Sender(_import_zmq().XPUB, address, bind, format, topic, wait_for, high_water_mark, linger)


def push(
    address: str, format: str = "json", bind: bool = True, high_water_mark: int = 1_000, linger: float = 1.0
) -> _Sender:
    """Returns a sender for PULL sockets, like `publish`. Its `send` blocks while no receiver has room."""
    return _Sender(_import_zmq().PUSH, address, bind, format, None, 0, high_water_mark, linger)


class _Socket:
    def __init__(self, kind: int, address: str, bind: bool, high_water_mark: int) -> None:
        zmq = _import_zmq()
        self._zmq, self._socket = zmq, zmq.Context.instance().socket(kind)
        self._socket.setsockopt(zmq.RCVHWM if kind in (zmq.SUB, zmq.PULL) else zmq.SNDHWM, high_water_mark)
        if bind:
            self._socket.bind(address)
            self.address = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)
        else:
            self._socket.connect(address)
            self.address = address

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the socket."""
        self._socket.close()


class _Receiver(_Socket):
    def __init__(
        self,
        kind: int,
        address: str,
        bind: bool,
        format: str,
        timeout: Optional[float],
        high_water_mark: int,
        topic_filter: Optional[tuple[str, bool]],
    ) -> None:
        super().__init__(kind, address, bind, high_water_mark)
        self._format, self._timeout, self._topic_filter, self.unreadable = format, timeout, topic_filter, 0
        if topic_filter:
            self._socket.setsockopt(self._zmq.SUBSCRIBE, topic_filter[0].encode())

    def __iter__(self) -> _Receiver:
        return self

    def __next__(self) -> Message:
        while True:
            if not self._socket.poll(None if self._timeout is None else int(self._timeout * 1_000)):
                raise StopIteration
            frames = self._socket.recv_multipart()
            if self._topic_filter and not self._topic_filter[1] and frames[0] != self._topic_filter[0].encode():
                continue
            try:
                time, data = formats.decode_message(self._format, frames[-1], now())
                return Message(time, data)
            except Damaged:
                self.unreadable += 1


class _Sender(_Socket):
    def __init__(
        self,
        kind: int,
        address: str,
        bind: bool,
        format: str,
        topic: Optional[str],
        wait_for: int,
        high_water_mark: int,
        linger: float,
    ) -> None:
        super().__init__(kind, address, bind, high_water_mark)
        self._format, self._topic, self._wait_for, self._linger = format, topic, wait_for, linger

    def send(self, time: int, data: Any) -> None:
        """Sends a message with its time in nanoseconds."""
        payload = formats.encode_message(self._format, time, data)
        if self._topic is None:
            self._socket.send(payload)
            return
        # An XPUB socket receives subscriptions; a PUB socket does not.
        while self._wait_for > 0 or self._socket.poll(0):
            self._wait_for -= 1 if self._is_subscription(self._socket.recv()) else 0
        self._socket.send_multipart([self._topic.encode(), payload])

    def _is_subscription(self, notification: bytes) -> bool:
        return notification[:1] == b"\1" and (self._topic or "").encode().startswith(notification[1:])

    def close(self) -> None:
        """Closes the socket after sending pending messages for at most `linger` seconds."""
        self._socket.close(linger=int(self._linger * 1_000))
