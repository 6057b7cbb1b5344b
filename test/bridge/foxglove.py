"""Tests a client of the protocol foxglove.sdk.v1 (robo-ws-bridge): channels, messages and playback control. PORT."""
import asyncio
import json
import struct
import sys

from robo_ws_bridge import WebSocketBridgeClient


async def run_client(port):
    client = WebSocketBridgeClient(f"ws://127.0.0.1:{port}")
    values, states, done = [], [], asyncio.Event()

    @client.on_message
    async def on_message(channel, timestamp, payload):
        values.append((timestamp, json.loads(payload)["n"]))

    original_handler = client._handle_binary

    async def handle_binary(data):
        if data[0] == 5:
            states.append(struct.unpack_from("<BQfB", data, 1) + (data[19:].decode(),))
            done.set()
        else:
            await original_handler(data)

    client._handle_binary = handle_binary
    await client.connect()
    await client.subscribe("/Values")

    async def wait_until(condition, failure):
        for _ in range(3_000):
            if condition():
                return
            await asyncio.sleep(0.02)
        raise AssertionError(failure)

    await wait_until(lambda: len(values) >= 1, "no message arrived")
    assert "playbackControl" in client.server_info["capabilities"], client.server_info
    assert client.server_info["dataStartTime"] == {"sec": 1, "nsec": 0}
    # Seeks and pauses: the value at that time arrives, and nothing else.
    await client._websocket.send(struct.pack("<BBfBQI2s", 3, 1, 1.0, 1, 1_800_000_000, 2, b"me"))
    await wait_until(lambda: (1, 1_800_000_000, 1.0, 1, "me") in states, "the seek was not acknowledged")
    await wait_until(lambda: values[-1] == (1_800_000_000, 80), "the value at 1.8 s did not arrive")
    before = len(values)
    # Plays to the end at four times the speed.
    await client._websocket.send(struct.pack("<BBfBQI", 3, 0, 4.0, 0, 0, 0))
    await wait_until(lambda: states[-1][0] == 3, "the end was not reported")
    await wait_until(lambda: values[-1][1] == 99, "the last message did not arrive")
    assert [n for _, n in values[before:]] == list(range(81, 100)), values[before:]
    await client.disconnect()


asyncio.run(run_client(sys.argv[1]))
