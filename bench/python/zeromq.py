"""Sends N messages with pyzmq from one process to another, as JSON with a time.

Prints the rate, and the CPU time of both processes per message in us. With "latency", sends 1,000 messages per second
and prints their latency, p50 and p99, in us.
"""
import json
import multiprocessing
import resource
import sys
import time

import zmq


def publish_all(port, n):
    socket = zmq.Context.instance().socket(zmq.XPUB)
    socket.setsockopt(zmq.SNDHWM, 0)
    port.send(socket.bind_to_random_port("tcp://127.0.0.1"))
    socket.recv()
    for i in range(1, n + 1):
        payload = {"originatingTime": f"2020-01-01T00:00:00.{i % 10_000_000:07}Z", "message": {"n": i, "x": i / 3}}
        socket.send_multipart([b"b", json.dumps(payload).encode()])
    port.send(None)
    socket.close(linger=60_000)


def cpu_time(who):
    usage = resource.getrusage(who)
    return usage.ru_utime + usage.ru_stime


def publish_timed(port, n):
    socket = zmq.Context.instance().socket(zmq.XPUB)
    port.send(socket.bind_to_random_port("tcp://127.0.0.1"))
    socket.recv()
    began = time.monotonic()
    for i in range(n):
        time.sleep(max(0, began + i / 1_000 - time.monotonic()))
        payload = {"originatingTime": "2020-01-01T00:00:00.0000000Z", "message": time.monotonic_ns()}
        socket.send_multipart([b"b", json.dumps(payload).encode()])
    socket.close(linger=60_000)


def measure_latency(n):
    parent_end, child_end = multiprocessing.Pipe()
    publisher = multiprocessing.Process(target=publish_timed, args=(child_end, n))
    publisher.start()
    socket = zmq.Context.instance().socket(zmq.SUB)
    socket.connect(f"tcp://127.0.0.1:{parent_end.recv()}")
    socket.setsockopt(zmq.SUBSCRIBE, b"b")
    times = []
    for _ in range(n):
        assert socket.poll(60_000), "no more messages arrived"
        times.append((time.monotonic_ns() - json.loads(socket.recv_multipart()[1])["message"]) / 1_000)
    publisher.join()
    times = sorted(times[n // 10 :])
    print(times[len(times) // 2], times[int(0.99 * (len(times) - 1))])


if __name__ == "__main__":
    n = int(sys.argv[1])
    if sys.argv[2:] == ["latency"]:
        measure_latency(n)
        sys.exit()
    parent_end, child_end = multiprocessing.Pipe()
    before = cpu_time(resource.RUSAGE_SELF)
    publisher = multiprocessing.Process(target=publish_all, args=(child_end, n))
    publisher.start()
    socket = zmq.Context.instance().socket(zmq.SUB)
    socket.setsockopt(zmq.RCVHWM, 0)
    socket.connect(f"tcp://127.0.0.1:{parent_end.recv()}")
    socket.setsockopt(zmq.SUBSCRIBE, b"b")
    began, last = time.monotonic(), 0
    while last < n:
        assert socket.poll(60_000), "no more messages arrived"
        last = json.loads(socket.recv_multipart()[1])["message"]["n"]
    took = time.monotonic() - began
    parent_end.recv()
    publisher.join()
    used = cpu_time(resource.RUSAGE_SELF) - before + cpu_time(resource.RUSAGE_CHILDREN)
    print(n / took, used / n * 1e6)
