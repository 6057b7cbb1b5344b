"""Prints a port of 127.0.0.1 that is free now, below those that the system gives to connections by itself."""
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
