"""Round trips through another process with pyzmq, ezmsg and dora: `component.py LIBRARY latency|images N`.

Prints p50 and p99 in us of N messages at 1,000 per second, or the CPU time of all processes in percent of a core for
N images of 1920 x 1080 RGB at 200 per second, of which the other process returns brighter copies.
"""

import os
import subprocess
import sys
import time

import numpy

PERIOD = {"latency": 0.001, "images": 0.005}
IMAGE = numpy.full((1080, 1920, 3), 2, "uint8")


def metronome(kind, n):
    start = time.monotonic()
    for i in range(n):
        wait = start + i * PERIOD[kind] - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        yield i


def report(kind, times, cpu, wall):
    times = sorted(times[len(times) // 3 :])
    if kind == "latency":
        print(times[len(times) // 2] * 1e6, times[len(times) * 99 // 100] * 1e6)
    else:
        print(100.0 * cpu / wall)


def cpu_of(*pids):
    ticks = 0
    for pid in pids:
        for task in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{task}/schedstat") as file:
                ticks += int(file.read().split()[0])
    return ticks / 1e9


def zeromq(kind, n):
    import zmq

    address = f"ipc:///tmp/situ-peer-{os.getpid()}"
    child = os.fork()
    socket = zmq.Context().socket(zmq.PAIR)
    socket.set_hwm(8)
    if child == 0:
        socket.connect(address)
        while True:
            frame = socket.recv(copy=False)
            if len(frame) == 0:
                os._exit(0)
            if kind == "latency":
                socket.send(frame.bytes)
            else:
                socket.send(numpy.frombuffer(frame.buffer, "uint8") + 1, copy=False)
    socket.bind(address)
    times, began, cpu = [], time.monotonic(), cpu_of(child, os.getpid())
    for _ in metronome(kind, n):
        sent = time.monotonic()
        socket.send(b"12345678" if kind == "latency" else IMAGE, copy=False)
        socket.recv(copy=False)
        times.append(time.monotonic() - sent)
    report(kind, times, cpu_of(child, os.getpid()) - cpu, time.monotonic() - began)
    socket.send(b"")
    os.wait()


def ezmsg(kind, n):
    import ezmsg_peer

    ezmsg_peer.run(kind, n, PERIOD[kind])


def dora(kind, n):
    folder = os.path.dirname(os.path.abspath(__file__))
    program = os.path.join(folder, "dora_peer.py")
    flow = f"/tmp/situ-dora-{os.getpid()}.yml"
    result = flow + ".result"
    node = lambda name, inputs: (
        f"  - id: {name}\n    path: {program}\n    args: {name} {kind} {n} {result}\n"
        f"    inputs:\n      in: {inputs}\n    outputs: [out]\n"
    )
    with open(flow, "w") as file:
        file.write("nodes:\n" + node("camera", "echo/out") + node("echo", "camera/out"))
    cli = os.path.join(os.path.dirname(sys.executable), "dora")
    subprocess.run([cli, "run", flow], check=True, stdout=subprocess.DEVNULL, timeout=120)
    with open(result) as file:
        print(file.read())


if __name__ == "__main__":
    {"zeromq": zeromq, "ezmsg": ezmsg, "dora": dora}[sys.argv[1]](sys.argv[2], int(sys.argv[3]))
