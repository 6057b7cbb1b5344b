import test from "node:test";
import assert from "node:assert/strict";
import { InstantChannel } from "../../js/data/channels.js";
import { KIND } from "../../js/data/wire.js";

const client = { rel: Number };
const frame = (items) => ({ kind: KIND.scene, time: 5, items });
const mesh = (more) => ({ kind: "meshes", count: 1, matrix: [1], ...more });
const whole = (name) =>
  mesh({ keep: name, position: new Float32Array([1, 2, 3]), index: new Uint32Array([0, 0, 0]) });

test("a mesh that is held has the numbers it came with, and its own place", () => {
  const got = [];
  const channel = new InstantChannel(1, {}, (f) => got.push(f));
  channel.opened = true;
  channel.receive(frame([whole("a")]), client);
  channel.receive(frame([mesh({ held: "a", matrix: [2] })]), client);
  const [first, second] = got.map((f) => f.items[0]);
  assert.equal(second.position, first.position);
  assert.equal(second.index, first.index);
  assert.deepEqual([second.count, second.matrix], [1, [2]]);
  assert.ok(channel.opened);
});

test("one that is not held is left out, and all is asked for again", () => {
  const got = [];
  const channel = new InstantChannel(1, {}, (f) => got.push(f));
  channel.opened = true;
  channel.receive(frame([mesh({ held: "b" }), { kind: "boxes", count: 1 }]), client);
  assert.deepEqual(
    got[0].items.map((item) => item.kind),
    ["boxes"],
  );
  assert.deepEqual([channel.opened, channel.at, channel.kept.size], [false, null, 0]);
});
