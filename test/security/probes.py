#!/usr/bin/env python3
"""Attacks a running studio. Each probe has a name and asserts the correct reaction. The last line counts the probes.

    probes.py PORT PORT_WITH_TOKEN CONTROL [WORD ...]     runs the probes whose names contain a WORD
"""
import base64
import hashlib
import hmac
import json
import random
import socket
import sys
import time
import traceback

from client import Client

OPEN, CLOSED, CONTROL = (int(a) for a in sys.argv[1:4])
TOKEN = "right-token-of-the-test"
LIVE = "/live/websocket?vsn=2.0.0"
studio = Client(OPEN)
probes = []


def probe(name):
    def add_probe(function):
        probes.append((name, function))
        return function
    return add_probe


def vm_numbers():
    with socket.create_connection(("127.0.0.1", CONTROL), 60) as s:
        s.sendall(b"\n")
        return json.loads(s.makefile().readline())


def check_responsive(client=None, within=10):
    """Asserts that the studio serves a page to another client in time."""
    began = time.monotonic()
    status, _ = (client or Client(OPEN, "127.0.0.9")).request("/", timeout=within)
    took = time.monotonic() - began
    assert status == 200, f"a page returned {status} after {took:.1f} s"
    assert took < within, f"a page took {took:.1f} s"


def join_page(client=studio, path="/s/Talk"):
    view, session = client.find_view(path)
    ws = client.open_socket(LIVE)
    response = ws.join_view(view, session, f"http://localhost:{client.port}{path}")
    assert response and response[4]["status"] == "ok", f"no view at {path}: {response}"
    return ws, f"lv:{view}"


# Hosts, origins and requests

@probe("a foreign host name is rejected")
def _():
    for host in ["evil.example", "evil.example:80", "localhost.evil.example", "localhost:80@evil.example", "",
                 "127.0.0.1.evil.example", "[::1", "localhost:x", "localhost:123456"]:
        status, _ = studio.request("/", host=host or " ")
        assert status != 200, f"Host: {host!r} was accepted"


@probe("a foreign origin cannot open a socket or send a form")
def _():
    for origin in ["http://evil.example", "null", f"http://localhost:{OPEN + 1}", "https://localhost", "file://"]:
        for path in [LIVE, "/data/socket"]:
            ws = studio.open_socket(path, [("Origin", origin)])
            assert not ws.open, f"{origin} opened {path}"
            ws.close()
        status, _ = studio.request("/", [("Origin", origin), ("Content-Length", "0")], method="POST")
        assert status in (403, 404, 405), f"POST from {origin}: {status}"


@probe("unsupported methods are rejected")
def _():
    for method in ["TRACE", "CONNECT", "PUT", "DELETE", "PATCH", "BREW", "A" * 4000]:
        status, _ = studio.request("/", method=method)
        assert status != 200, f"{method[:20]!r} was accepted"


@probe("60 malicious paths do not leave the served folders")
def _():
    up = ["..", "%2e%2e", "%2E%2e", "..%2f", "%252e%252e", "..;", "..%5c", "..%00", "%c0%ae%c0%ae", ".%2e"]
    for where in ["/assets", "/s", "/p", "/data/window?source=", "/s/Talk", ""]:
        for step in up:
            separator = "" if step.endswith("%2f") else "/"
            path = f"{where}/" + separator.join([step] * 9) + separator + "etc/passwd"
            _, response = studio.request(path)
            assert b"root:x:0" not in response, f"{path} returned the file"


@probe("a malformed query causes no server error")
def _():
    for query in ["source[a]=1", "source[]=1", "source[a][b]=1", "source=%zz", "source=%ff", "=&=&", "source", "[]=1",
                  "from[x]=1", "px=-1", "px=1e9", "px=" + "9" * 5000, "path[" * 500, "at[a]=1", "viz[a]=1", "stream[a]=b"]:
        for path in ["/", "/s/Talk", "/p/x", "/data/window", "/data/at", "/data/pcm", "/data/step"]:
            for prefix in ["", "source=Talk&stream=level&"]:
                status, _ = studio.request(f"{path}?{prefix}{query}")
                assert status is None or status < 500, f"{path}?{prefix}{query[:60]}: {status}"


# Tokens

@probe("the studio serves nothing without the token, and everything with it")
def _():
    closed = Client(CLOSED, "127.0.0.3")
    for path in ["/", "/s/Talk", "/data/window?source=Talk&stream=level"]:
        status, response = closed.request(path)
        assert status in (401, 403), f"{path}: {status}"
        assert b"Talk" not in response
    for path in [LIVE, "/data/socket"]:
        assert not closed.open_socket(path).open
    for given in ["Bearer " + TOKEN]:
        status, _ = closed.request("/", [("Authorization", given)])
        assert status == 200, f"the right token: {status}"


@probe("wrong tokens are slowed down, other clients are not")
def _():
    guesser, owner = Client(CLOSED, "127.0.0.4"), Client(CLOSED, "127.0.0.5")
    statuses = []
    for i in range(200):
        status, _ = guesser.request("/", [("Authorization", f"Bearer guess-{i}")])
        statuses.append(status)
        if status == 429:
            break
    assert 200 not in statuses
    assert 429 in statuses, "200 guesses were all answered immediately"
    status, _ = owner.request("/", [("Authorization", f"Bearer {TOKEN}")])
    assert status == 200, f"the right token of another client: {status}"


@probe("forged session tokens are rejected")
def _():
    view, session = studio.find_view("/")
    body, mac = session.split(".")
    decoded = json.loads(base64.urlsafe_b64decode(body + "=" * (-len(body) % 4)))

    def encode_base64(value):
        return base64.urlsafe_b64encode(value).decode().rstrip("=")

    other = encode_base64(json.dumps(decoded).replace("open", "closed").encode())
    empty = encode_base64(hmac.new(b"", body.encode(), hashlib.sha256).digest())
    url = f"http://localhost:{OPEN}/"
    for name, forged in [("none", ""), ("no signature", body), ("empty signature", body + "."),
                         ("other body", f"{other}.{mac}"), ("empty key", f"{body}.{empty}"),
                         ("cut", session[:-2]), ("longer", session + "A"), ("a list", "W10.W10"), ("long", "A" * 100_000)]:
        ws = studio.open_socket(LIVE)
        response = ws.join_view(view, forged, url)
        assert not (response and response[3] == "phx_reply" and response[4]["status"] == "ok"), f"{name} was accepted"
        ws.close()
    check_responsive()


# Excessive input

@probe("very long numbers do not block the studio")
def _():
    sockets = [studio.open_socket(LIVE) for _ in range(4)]
    for ws in sockets:
        ws.send(b'[null,"1","phoenix","heartbeat",{"n":' + b"7" * 250_000 + b"}]")
    check_responsive(within=5)
    for ws in sockets:
        ws.close()
    check_responsive(within=5)


@probe("links in the recordings' folder are not followed")
def _():
    began = time.monotonic()
    for path in ["/", "/s/Talk", "/s/a/a/b/Talk", "/s/root/etc/passwd", "/s/root/proc/self/environ"]:
        status, response = studio.request(path, timeout=20)
        assert status is not None and status < 500, f"{path}: {status}"
        assert b"root:x:0" not in response
    assert time.monotonic() - began < 20


@probe("a playlist with the name of a video reads no other file")
def _():
    for path in ["/s/list.mp4", "/data/window?source=list.mp4&stream=video", "/data/at?source=list.mp4&stream=video&at=0"]:
        _, response = studio.request(path, timeout=30)
        assert b"root:x:0" not in response
    check_responsive()


@probe("frames that are endless, unmasked, or longer than announced")
def _():
    for send in [
        lambda ws: [ws.send(b"", final=False, opcode=1)] + [ws.send(b"", final=False, opcode=0) for _ in range(32_000)],
        lambda ws: ws.send(b"[]", masked=False),
        lambda ws: ws.s.sendall(ws.encode_frame(b"x", length=1 << 62)),
        lambda ws: ws.s.sendall(ws.encode_frame(b"x" * 100, length=2_000_000)),
        lambda ws: ws.send(b"x" * 126, opcode=9),
        lambda ws: ws.send(b"x", opcode=3),
        lambda ws: ws.send(b"\xff\xfe\xfd"),
        lambda ws: ws.send(b"", opcode=0),
    ]:
        for path in [LIVE, "/data/socket"]:
            ws = studio.open_socket(path)
            try:
                send(ws)
            except OSError:
                pass
            check_responsive(within=5)
            ws.close()


@probe("200 clients that stop sending, and 100 that never read")
def _():
    slow = [Client(OPEN, "127.0.0.6").connect() for _ in range(200)]
    for s in slow:
        s.sendall(b"GET / HTTP/1.1\r\nHost: loc")
    silent = [Client(OPEN, "127.0.0.7").connect() for _ in range(100)]
    for s in silent:
        s.sendall(b"GET /assets/studio.js HTTP/1.1\r\nHost: localhost\r\n\r\n" * 20)
    check_responsive()
    for s in slow + silent:
        s.close()
    check_responsive()


@probe("one peer's 2,100 connections leave room for others")
def _():
    greedy, held = Client(OPEN, "127.0.0.8"), []
    for _ in range(2_100):
        try:
            s = greedy.connect(2)
            s.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n")
            held.append(s)
        except OSError:
            break
    try:
        # All 2,000 accepted connections may belong to the greedy client until the server's next check.
        ends = time.monotonic() + 5
        while time.monotonic() < ends and Client(OPEN, "127.0.0.9").request("/", timeout=5)[0] != 200:
            time.sleep(0.2)
        check_responsive()
    finally:
        for s in held:
            s.close()


@probe("the cost of requests is limited")
def _():
    before = vm_numbers()["memory"]
    for _ in range(64):
        status, _ = studio.request("/data/window?source=Talk&stream=level&viz=line&px=49000")
        assert status in (400, 413, 422, 429), f"49,000 bins: {status}"
    ws, topic = join_page()
    for i in range(100):
        ws.send_json(["1", f"t{i}", topic, "event", {"type": "click", "event": "toggle", "value": {"path": "x" * 200_000 + str(i)}}])
    check_responsive(within=15)
    ws.close()
    time.sleep(1)
    assert vm_numbers()["memory"] - before < 64 << 20, "memory grew by more than 64 MiB"


KEYS = "stream panel viz path kind id by side target way min max index props key from to of name query layout level".split()
VALUES = ["level", "words", "boxes", "Talk", "", ".x", "[0]", "above", "all", "auto", "line", "0", "-1", "1e999", "nan",
          "9" * 30, "__proto__", "Elixir.System", "../../x", "%00", "\u2028", "<script>", 0, -1, 2**70, 1e308, None, True,
          [], {}, [[[]]], {"a": {"b": []}}, "x" * 5000]


def random_message(chance, topic, reference):
    value = {chance.choice(KEYS): chance.choice(VALUES) for _ in range(chance.randrange(8))}
    names = ["add_stream", "add_viz", "axis", "move_row", "place_panel", "plot_path", "prop", "remove_panel", "select",
             "resize_row", "select_panel", "threshold", "export_dialog", "export_save", "snap", "fold", "layout_save",
             "layout_delete", "layout_pick", "pick", "search", "toggle", "unknown", "lv:clear-flash", ""]
    kind = chance.random()
    if kind < .7:
        payload = {"type": chance.choice(["click", "form", "hook", None, 3]), "event": chance.choice(names), "value": value}
        return ["1", reference, topic, "event", payload]
    if kind < .85:
        kind = chance.choice(["live_patch", "phx_leave", "cids_destroyed", "upload", "", "diff", "phx_join"])
        return ["1", reference, topic, kind, chance.choice([value, None, 3, [], {"url": chance.choice(VALUES)}])]
    if kind < .95:
        return ["1", reference, chance.choice(["lv:zz", "phoenix", "", "lvu:x"]), "event", value]
    return chance.choice([[], {}, [1, 2, 3, 4, 5], None, 3, "x", ["1", reference, topic, "event", []]])


@probe("20,000 random messages leave no processes, atoms or memory behind")
def _():
    chance = random.Random(20_261_122)
    join_page()[0].close()
    time.sleep(1)
    before, sent = vm_numbers(), 0
    while sent < 20_000:
        ws, topic = join_page(path=chance.choice(["/s/Talk", "/"]))
        for _ in range(20):
            batch = [json.dumps(random_message(chance, topic, str(sent + i))).encode() for i in range(50)]
            try:
                ws.s.sendall(b"".join(ws.encode_frame(b) for b in batch))
                ws.send_json([None, f"beat{sent}", "phoenix", "heartbeat", {}])
            except OSError:
                break
            finally:
                sent += len(batch)
            if ws.receive_reply(f"beat{sent - len(batch)}") is None:
                break
        ws.close()
    check_responsive()
    time.sleep(3)
    after = vm_numbers()
    assert after["atoms"] - before["atoms"] < 500, f"{after['atoms'] - before['atoms']} new atoms"
    assert after["processes"] - before["processes"] < 20, f"{after['processes'] - before['processes']} new processes"
    assert after["memory"] - before["memory"] < 48 << 20, f"{(after['memory'] - before['memory']) >> 20} MiB more"


passed = failed = 0
for name, function in probes:
    if sys.argv[4:] and not any(word in name for word in sys.argv[4:]):
        continue
    began = time.monotonic()
    try:
        function()
        passed += 1
        print(f"ok: {name} ({time.monotonic() - began:.1f} s)")
    except Exception as error:  # A probe that cannot run has failed.
        failed += 1
        print(f"FAILED: {name}: {error if isinstance(error, AssertionError) else traceback.format_exc()}")
print(f"{passed} passed, {failed} failed")
sys.exit(failed > 0)
