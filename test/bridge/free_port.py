"""Prints a free port of 127.0.0.1, below the range that the system assigns to connections automatically."""
import random
import socket

while True:
    port = random.randrange(20_000, 32_000)
    with socket.socket() as attempt:
        try:
            attempt.bind(("127.0.0.1", port))
        except OSError:
            continue
        print(port)
        break
