import test from "node:test";
import assert from "node:assert/strict";
import { InstantChannel } from "../../js/data/channels.js";
import { KIND } from "../../js/data/frames.js";

const client = { toRelative: Number };
const sceneFrame = (items) => ({ kind: KIND.scene, time: 5, items });
const meshItem = (more) => ({ kind: "meshes", count: 1, matrix: [1], ...more });
const completeMesh = (name) =>
  meshItem({ keep: name, position: new Float32Array([1, 2, 3]), index: new Uint32Array([0, 0, 0]) });

test("a held mesh keeps its arrays and gets its own matrix", () => {
  const got = [];
  const channel = new InstantChannel(1, {}, (f) => got.push(f));
  channel.opened = true;
  channel.receiveFrame(sceneFrame([completeMesh("a")]), client);
  channel.receiveFrame(sceneFrame([meshItem({ held: "a", matrix: [2] })]), client);
  const [first, second] = got.map((f) => f.items[0]);
  assert.equal(second.position, first.position);
  assert.equal(second.index, first.index);
  assert.deepEqual([second.count, second.matrix], [1, [2]]);
  assert.ok(channel.opened);
});

test("a mesh that is not held is omitted, and the channel is reopened", () => {
  const got = [];
  const channel = new InstantChannel(1, {}, (f) => got.push(f));
  channel.opened = true;
  channel.receiveFrame(sceneFrame([meshItem({ held: "b" }), { kind: "boxes", count: 1 }]), client);
  assert.deepEqual(
    got[0].items.map((item) => item.kind),
    ["boxes"],
  );
  assert.deepEqual([channel.opened, channel.at, channel.kept.size], [false, null, 0]);
});
