"""The nodes of `component.py` for dora."""

import os
import sys
import time

import pyarrow
from component import IMAGE, cpu_of, metronome, report
from dora import Node


def echo(node, kind):
    for event in node:
        if event["type"] == "INPUT":
            array = event["value"].to_numpy(zero_copy_only=True)
            result = array if kind == "latency" else array + 1
            node.send_output("out", pyarrow.array(result), {"pid": os.getpid()})
        elif event["type"] == "STOP":
            return


def camera(node, kind, count):
    value = pyarrow.array([1, 2], pyarrow.uint8()) if kind == "latency" else pyarrow.array(IMAGE.ravel())
    times, cpu = [], 0
    for _ in metronome(kind, count):
        sent = time.monotonic()
        node.send_output("out", value)
        event = node.next()
        if not times:
            began, cpu = time.monotonic(), cpu_of(event["metadata"]["pid"], os.getpid(), os.getppid())
        times.append(time.monotonic() - sent)
    return times, cpu_of(event["metadata"]["pid"], os.getpid(), os.getppid()) - cpu, time.monotonic() - began


if __name__ == "__main__":
    name, kind, count, result = sys.argv[1:]
    node = Node()
    if name == "echo":
        echo(node, kind)
    else:
        figures = camera(node, kind, int(count))
        with open(result, "w") as file:
            sys.stdout = file
            report(kind, *figures)
