"""A client of the protocol foxglove.sdk.v1 (robo-ws-bridge): channels, messages, the app's own control of the playback. PORT."""
import asyncio
import json
import struct
import sys

from robo_ws_bridge import WebSocketBridgeClient


async def main(port):
    client = WebSocketBridgeClient(f"ws://127.0.0.1:{port}")
    values, states, done = [], [], asyncio.Event()

    @client.on_message
    async def _(channel, timestamp, payload):
        values.append((timestamp, json.loads(payload)["n"]))

    binary = client._handle_binary

    async def listening(data):
        if data[0] == 5:
            states.append(struct.unpack_from("<BQfB", data, 1) + (data[19:].decode(),))
            done.set()
        else:
            await binary(data)

    client._handle_binary = listening
    await client.connect()
    await client.subscribe("/Values")

    async def reached(condition, what):
        for _ in range(3_000):
            if condition():
                return
            await asyncio.sleep(0.02)
        raise AssertionError(what)

    await reached(lambda: len(values) >= 1, "no message came")
    assert "playbackControl" in client.server_info["capabilities"], client.server_info
    assert client.server_info["dataStartTime"] == {"sec": 1, "nsec": 0}
    # Seek, pause: what holds there, and nothing more.
    await client._websocket.send(struct.pack("<BBfBQI2s", 3, 1, 1.0, 1, 1_800_000_000, 2, b"me"))
    await reached(lambda: (1, 1_800_000_000, 1.0, 1, "me") in states, "the seek was not answered")
    await reached(lambda: values[-1] == (1_800_000_000, 80), "what holds at 1.8 s did not come")
    before = len(values)
    # Play at four times the speed, to the end.
    await client._websocket.send(struct.pack("<BBfBQI", 3, 0, 4.0, 0, 0, 0))
    await reached(lambda: states[-1][0] == 3, "the end was not told of")
    await reached(lambda: values[-1][1] == 99, "the last message did not come")
    assert [n for _, n in values[before:]] == list(range(81, 100)), values[before:]
    await client.disconnect()


asyncio.run(main(sys.argv[1]))
