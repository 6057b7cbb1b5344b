"""N messages by pyzmq from one process to another, as JSON with a time: the rate, and CPU time a message of both, us;
with "latency", at 1,000 a second: how long they are on their way, p50 and p99, us."""
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


def metronome(port, n):
    socket = zmq.Context.instance().socket(zmq.XPUB)
    port.send(socket.bind_to_random_port("tcp://127.0.0.1"))
    socket.recv()
    began = time.monotonic()
    for i in range(n):
        time.sleep(max(0, began + i / 1_000 - time.monotonic()))
        payload = {"originatingTime": "2020-01-01T00:00:00.0000000Z", "message": time.monotonic_ns()}
        socket.send_multipart([b"b", json.dumps(payload).encode()])
    socket.close(linger=60_000)


def latency(n):
    ours, theirs = multiprocessing.Pipe()
    publisher = multiprocessing.Process(target=metronome, args=(theirs, n))
    publisher.start()
    socket = zmq.Context.instance().socket(zmq.SUB)
    socket.connect(f"tcp://127.0.0.1:{ours.recv()}")
    socket.setsockopt(zmq.SUBSCRIBE, b"b")
    times = []
    for _ in range(n):
        assert socket.poll(60_000), "nothing more came"
        times.append((time.monotonic_ns() - json.loads(socket.recv_multipart()[1])["message"]) / 1_000)
    publisher.join()
    times = sorted(times[n // 10 :])
    print(times[len(times) // 2], times[int(0.99 * (len(times) - 1))])


if __name__ == "__main__":
    n = int(sys.argv[1])
    if sys.argv[2:] == ["latency"]:
        latency(n)
        sys.exit()
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
