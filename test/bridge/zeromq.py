"""libzmq's side of the ZeroMQ test: sub, pub (which restarts) and pull."""
import json
import sys
import time

import zmq

context = zmq.Context()
role, address = sys.argv[1], f"tcp://127.0.0.1:{sys.argv[2]}"


def encode_message(n):
    return json.dumps({"originatingTime": f"2020-01-01T00:{n // 60:02}:{n % 60:02}.0000000Z", "message": n}).encode()


def receive_messages(socket, n):
    poller = zmq.Poller()
    poller.register(socket)
    found = []
    while len(found) < n:
        assert poller.poll(60_000), f"only {len(found)} messages arrived"
        found.append(socket.recv_multipart())
    return found


if role == "sub":
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.SUBSCRIBE, b"levels")
    socket.setsockopt(zmq.RCVHWM, 0)
    socket.connect(address)
    found = receive_messages(socket, 2_000)
    assert all(topic == b"levels" for topic, _ in found)
    assert [json.loads(payload)["message"]["n"] for _, payload in found] == list(range(1, 2_001))
elif role == "pull":
    socket = context.socket(zmq.PULL)
    socket.connect(address)
    assert [json.loads(payload)["message"] for payload, in receive_messages(socket, 2_000)] == list(range(1, 2_001))
else:
    n = 0
    for _ in range(2):
        socket = context.socket(zmq.XPUB)
        socket.setsockopt(zmq.SNDHWM, 0)
        socket.bind(address)
        assert socket.poll(60_000), "there is no subscriber"
        assert socket.recv() == b"\x01a"
        for _ in range(1_000):
            n += 1
            socket.send_multipart([b"ab", b"another topic"])
            socket.send_multipart([b"a", encode_message(n)])
        time.sleep(0.5)
        socket.close()
        context.destroy(linger=1000)
        context = zmq.Context()
