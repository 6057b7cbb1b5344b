"""Sends handmade requests and WebSocket frames, which can be malformed in any way. Uses the standard library only."""
import base64
import json
import os
import re
import socket
import struct


class Client:
    """A client of one server. `source` is its loopback address, so that a test can have several peers."""

    def __init__(self, port, source="127.0.0.1"):
        self.port, self.source = port, source

    def connect(self, timeout=10):
        """Returns a connected socket."""
        return socket.create_connection(("127.0.0.1", self.port), timeout, (self.source, 0))

    def send_raw(self, data, timeout=10):
        """Sends bytes, and returns the response until the server closes or is silent for `timeout` seconds."""
        out = b""
        with self.connect(timeout) as s:
            try:
                s.sendall(data)
                while chunk := s.recv(65536):
                    out += chunk
            except OSError:
                pass
        return out

    def request(self, path, headers=(), host=None, method="GET", timeout=10):
        """Sends an HTTP request, and returns the status and the complete response."""
        lines = [f"{method} {path} HTTP/1.1", f"Host: {host or f'localhost:{self.port}'}", "Connection: close"]
        lines += [f"{name}: {value}" for name, value in headers]
        response = self.send_raw(("\r\n".join(lines) + "\r\n\r\n").encode("latin1"), timeout)
        found = re.match(rb"HTTP/1\.[01] (\d+)", response)
        return (int(found[1]) if found else None), response

    def open_socket(self, path, headers=(), timeout=20):
        return WebSocket(self, path, headers, timeout)

    def find_view(self, path="/", headers=(), source=None):
        """Returns the id and the session token of the view on a page."""
        _, response = self.request(path, headers)
        found = re.search(rb'id="(phx-[^"]+)" data-phx-main data-phx-session="([^"]+)"', response)
        return (found[1].decode(), found[2].decode()) if found else (None, None)


class WebSocket:
    """A WebSocket that can send invalid frames."""
    def __init__(self, client, path, headers, timeout):
        self.s = client.connect(timeout)
        key = base64.b64encode(os.urandom(16)).decode()
        origin = [] if any(n == "Origin" for n, _ in headers) else [("Origin", f"http://localhost:{client.port}")]
        lines = [f"GET {path} HTTP/1.1", f"Host: localhost:{client.port}", "Upgrade: websocket", "Connection: Upgrade",
                 f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13"]
        lines += [f"{n}: {v}" for n, v in [*origin, *headers]]
        self.s.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        self.buffer = b""
        while b"\r\n\r\n" not in self.buffer:
            chunk = self.s.recv(65536)
            if not chunk:
                break
            self.buffer += chunk
        self.head, _, self.buffer = self.buffer.partition(b"\r\n\r\n")
        self.open = b" 101 " in self.head.split(b"\r\n")[0]

    def encode_frame(self, data, opcode=1, final=True, masked=True, length=None):
        n = len(data) if length is None else length
        head = bytes([(0x80 if final else 0) | opcode])
        mask_bit = 0x80 if masked else 0
        if n < 126:
            head += bytes([mask_bit | n])
        elif n < 65536:
            head += bytes([mask_bit | 126]) + struct.pack(">H", n)
        else:
            head += bytes([mask_bit | 127]) + struct.pack(">Q", n)
        # A mask of zeros is valid and leaves the data unchanged.
        return head + (bytes(4) if masked else b"") + data

    def send(self, data, **how):
        self.s.sendall(self.encode_frame(data if isinstance(data, bytes) else data.encode(), **how))

    def send_json(self, value):
        self.send(json.dumps(value))

    def _fill_buffer(self, n):
        while len(self.buffer) < n:
            chunk = self.s.recv(1 << 20)
            if not chunk:
                raise EOFError
            self.buffer += chunk

    def receive(self):
        self._fill_buffer(2)
        opcode, n, at = self.buffer[0] & 15, self.buffer[1] & 127, 2
        if n == 126:
            self._fill_buffer(4)
            n, at = struct.unpack(">H", self.buffer[2:4])[0], 4
        elif n == 127:
            self._fill_buffer(10)
            n, at = struct.unpack(">Q", self.buffer[2:10])[0], 10
        self._fill_buffer(at + n)
        data, self.buffer = self.buffer[at:at + n], self.buffer[at + n:]
        return opcode, data

    def receive_reply(self, reference):
        """Returns the reply to the message `reference`, or None if the server closes first."""
        try:
            while True:
                opcode, data = self.receive()
                if opcode == 8:
                    return None
                if opcode == 1:
                    message = json.loads(data)
                    if message[1] == reference:
                        return message
        except (EOFError, OSError):
            return None

    def join_view(self, view, session, url):
        self.send_json(["1", "1", f"lv:{view}", "phx_join",
                        {"url": url, "params": {"_csrf_token": ""}, "session": session, "static": ""}])
        return self.receive_reply("1")

    def close(self):
        self.s.close()
