"""Runs blocks of code from standard input in one namespace, and replies "ok" or the traceback.

Each block and each reply is a big-endian length and a text.
"""
import struct
import sys
import traceback

replies, sys.stdout = sys.stdout.buffer, sys.stderr
names = {"__name__": "__main__"}
while head := sys.stdin.buffer.read(4):
    code = sys.stdin.buffer.read(struct.unpack(">I", head)[0]).decode()
    try:
        exec(compile(code, "guide", "exec"), names)
        reply = b"ok"
    except BaseException:
        reply = traceback.format_exc().encode()
    replies.write(struct.pack(">I", len(reply)) + reply)
    replies.flush()
