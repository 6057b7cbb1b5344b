"""N messages by pyzmq from one process to another, as JSON with a time: the rate, and CPU time a message, both processes (us)."""
import json
import multiprocessing
import resource
import sys
import time

import zmq


def publish(port, n):
    socket = zmq.Context.instance().socket(zmq.XPUB)
    socket.setsockopt(zmq.SNDHWM, 0)
    port.send(socket.bind_to_random_port("tcp://127.0.0.1"))
    socket.recv()
    for i in range(1, n + 1):
        payload = {"originatingTime": f"2020-01-01T00:00:00.{i % 10_000_000:07}Z", "message": {"n": i, "x": i / 3}}
        socket.send_multipart([b"b", json.dumps(payload).encode()])
    port.send(None)
    socket.close(linger=60_000)


def cpu(who):
    usage = resource.getrusage(who)
    return usage.ru_utime + usage.ru_stime


if __name__ == "__main__":
    n = int(sys.argv[1])
    ours, theirs = multiprocessing.Pipe()
    before = cpu(resource.RUSAGE_SELF)
    publisher = multiprocessing.Process(target=publish, args=(theirs, n))
    publisher.start()
    socket = zmq.Context.instance().socket(zmq.SUB)
    socket.setsockopt(zmq.RCVHWM, 0)
    socket.connect(f"tcp://127.0.0.1:{ours.recv()}")
    socket.setsockopt(zmq.SUBSCRIBE, b"b")
    began, last = time.monotonic(), 0
    while last < n:
        assert socket.poll(60_000), "nothing more came"
        last = json.loads(socket.recv_multipart()[1])["message"]["n"]
    took = time.monotonic() - began
    ours.recv()
    publisher.join()
    used = cpu(resource.RUSAGE_SELF) - before + cpu(resource.RUSAGE_CHILDREN)
    print(n / took, used / n * 1e6)
