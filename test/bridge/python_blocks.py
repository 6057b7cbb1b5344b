"""Runs blocks of code from standard input, each a big-endian length and its text, in one namespace; answers ok or the traceback."""
import struct
import sys
import traceback

answers, sys.stdout = sys.stdout.buffer, sys.stderr
names = {"__name__": "__main__"}
while head := sys.stdin.buffer.read(4):
    code = sys.stdin.buffer.read(struct.unpack(">I", head)[0]).decode()
    try:
        exec(compile(code, "guide", "exec"), names)
        answer = b"ok"
    except BaseException:
        answer = traceback.format_exc().encode()
    answers.write(struct.pack(">I", len(answer)) + answer)
    answers.flush()
