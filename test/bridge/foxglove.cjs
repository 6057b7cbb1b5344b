// Receives every message of a recording with Foxglove's own client, and pauses and seeks with parameters. PORT.
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { WebSocket } = require("ws");
const assert = require("node:assert");

const client = new FoxgloveClient({
  ws: new WebSocket(`ws://127.0.0.1:${process.argv[2]}`, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]),
});
const deadline = setTimeout(() => fail(new Error(`only ${values.length} messages came`)), 60_000);
const channels = new Map();
const values = [];
let picture,
  sought = false;

function fail(error) {
  console.error(error);
  process.exit(1);
}

client.on("error", fail);
client.on("close", () => fail(new Error("closed")));
client.on("advertise", (list) => {
  for (const channel of list) channels.set(channel.topic, channel);
  assert.equal(channels.get("/Camera").schemaName, "sensor_msgs/Image");
  client.subscribe(channels.get("/Camera").id);
  client.subscribe(channels.get("/Values").id);
  // Playback starts with the first subscription. The second one may arrive late, and then playback starts again.
  client.setParameters([{ name: "situ.position", value: 0 }], "begin");
});
client.on("message", ({ timestamp, data }) => {
  const bytes = Buffer.from(data.buffer, data.byteOffset, data.byteLength);
  if (bytes[0] !== 0x7b) return (picture = bytes);
  const { n } = JSON.parse(bytes.toString());
  if (n === 0) values.length = 0;
  values.push([timestamp, n]);
  if (values.length === 100 && !sought) {
    values.forEach((value, i) => assert.deepEqual(value, [1_000_000_000n + BigInt(i) * 10_000_000n, i]));
    assert.deepEqual([...picture.subarray(-3)], [1, 2, 3]);
    sought = true;
    client.setParameters(
      [
        { name: "situ.position", value: 0.5 },
        { name: "situ.paused", value: true },
      ],
      "seek",
    );
  }
});
client.on("parameterValues", ({ id, parameters }) => {
  if (id !== "seek") return;
  assert.deepEqual(values.at(-1), [1_500_000_000n, 50]);
  assert.deepEqual(parameters.find((p) => p.name === "situ.paused").value, true);
  clearTimeout(deadline);
  process.exit(0);
});
