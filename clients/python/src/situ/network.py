"""Live streams over ZeroMQ, the counterpart of `Situ.Bridge.ZeroMQ`.

`format` is one of `"json"` (the default), `"message_pack"`, `"situ"` (any value, with pictures, sound and arrays as
they are) and `"raw"`, and must be the same on both sides.
"""

from . import formats
from .bytes import Damaged, Missing
from .reading import Message
from .times import now


def _zmq():
    try:
        import zmq
    except ImportError:
        raise Missing("pyzmq: pip install situ[zeromq]") from None
    return zmq


def subscribe(address, topic="", prefix=False, format="json", bind=False, timeout=None, high_water_mark=1_000):
    """The messages of a topic, one after the other, for ever; with `timeout` (seconds) until none came for so long.

    `prefix` takes all topics that begin so. The result counts what could not be read (`unreadable`) and closes by
    `close()` or `with`.
    """
    return _Source(_zmq().SUB, address, bind, format, timeout, high_water_mark, (topic, prefix))


def pull(address, format="json", bind=False, timeout=None, high_water_mark=1_000):
    """The messages of a PUSH socket, like `subscribe`."""
    return _Source(_zmq().PULL, address, bind, format, timeout, high_water_mark, None)


def publish(address, topic, format="json", bind=True, wait_for=0, high_water_mark=1_000, linger=1.0):
    """Something to `send(time, data)` with; `wait_for`: send nothing before so many have subscribed."""
    return _Sink(_zmq().XPUB, address, bind, format, topic, wait_for, high_water_mark, linger)


def push(address, format="json", bind=True, high_water_mark=1_000, linger=1.0):
    """As `publish`, to whoever pulls; waits while nobody has room."""
    return _Sink(_zmq().PUSH, address, bind, format, None, 0, high_water_mark, linger)


class _Socket:
    def __init__(self, kind, address, bind, high_water_mark):
        zmq = _zmq()
        self._zmq, self._socket = zmq, zmq.Context.instance().socket(kind)
        self._socket.setsockopt(zmq.RCVHWM if kind in (zmq.SUB, zmq.PULL) else zmq.SNDHWM, high_water_mark)
        if bind:
            self._socket.bind(address)
            self.address = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)
        else:
            self._socket.connect(address)
            self.address = address

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        self._socket.close()


class _Source(_Socket):
    def __init__(self, kind, address, bind, format, timeout, high_water_mark, wanted):
        super().__init__(kind, address, bind, high_water_mark)
        self._format, self._timeout, self._wanted, self.unreadable = format, timeout, wanted, 0
        if wanted:
            self._socket.setsockopt(self._zmq.SUBSCRIBE, wanted[0].encode())

    def __iter__(self):
        return self

    def __next__(self):
        while True:
            if not self._socket.poll(None if self._timeout is None else int(self._timeout * 1_000)):
                raise StopIteration
            frames = self._socket.recv_multipart()
            if self._wanted and not self._wanted[1] and frames[0] != self._wanted[0].encode():
                continue
            try:
                time, data = formats.decode(self._format, frames[-1], now())
                return Message(time, data)
            except Damaged:
                self.unreadable += 1


class _Sink(_Socket):
    def __init__(self, kind, address, bind, format, topic, wait_for, high_water_mark, linger):
        super().__init__(kind, address, bind, high_water_mark)
        self._format, self._topic, self._wait_for, self._linger = format, topic, wait_for, linger

    def send(self, time, data):
        """Sends a message with its time."""
        payload = formats.encode(self._format, time, data)
        if self._topic is None:
            self._socket.send(payload)
            return
        # XPUB tells of subscriptions, PUB does not.
        while self._wait_for > 0 or self._socket.poll(0):
            self._wait_for -= 1 if self._subscribed(self._socket.recv()) else 0
        self._socket.send_multipart([self._topic.encode(), payload])

    def _subscribed(self, said):
        return said[:1] == b"\1" and self._topic.encode().startswith(said[1:])

    def close(self):
        self._socket.close(linger=int(self._linger * 1_000))
