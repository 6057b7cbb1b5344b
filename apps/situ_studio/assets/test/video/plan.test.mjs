import { test } from "node:test";
import assert from "node:assert/strict";
import { findMissing, planStep, skippable } from "../../js/video/plan.js";
import { PacketIndex } from "../../js/video/packet_index.js";

// 900 images with a key frame every 300, each third packet ahead of the two after it (B-frames).
const times = [];
for (let p = 0; p < 900; p++) times.push(p % 3 === 0 ? p + 2 : p - 1);
const index = new PacketIndex({
  times: Float64Array.from(times, (t) => Math.max(t, 0)),
  sizes: new Uint32Array(900).fill(1000),
  flags: Uint8Array.from(times, (_, p) => (p % 300 === 0 ? 1 : 0)),
});
const at = (next, more = {}) => ({ next, pending: new Set(), flushed: false, ...more });

test("the first missing image from the cursor on is decoded", () => {
  const cache = { has: (n) => n < 12 };
  assert.equal(findMissing(index, cache, 10, 1), -1);
  assert.equal(findMissing(index, cache, 10, 6), 12);
  assert.equal(findMissing(index, cache, -1, 6), -1);
  assert.equal(findMissing(index, { has: () => true }, 899, 6), -1);
});

test("a decoder continues in a group of images, and starts at the key frame of another", () => {
  const image = index.images[400];
  assert.equal(planStep(index, at(350), image), "feed");
  assert.equal(planStep(index, at(400), image), "feed");
  assert.deepEqual(planStep(index, at(401), image), { start: 300 }, "the image is behind the decoder");
  assert.deepEqual(planStep(index, at(-1), image), { start: 300 });
  assert.deepEqual(planStep(index, at(10), image), { start: 300 });
  assert.equal(planStep(index, at(298), image), "feed", "the key frame is near");
  assert.deepEqual(planStep(index, at(350, { flushed: true }), image), { start: 300 });
});

test("the decoder gets further packets until it returns the image", () => {
  const image = index.images[400];
  const pending = new Set([image]);
  assert.equal(planStep(index, at(404, { pending }), image), "feed");
  assert.equal(planStep(index, at(460, { pending }), image), "lost");
  const last = index.images[899];
  assert.equal(planStep(index, at(900, { pending: new Set([last]) }), last), "flush");
  assert.equal(planStep(index, at(900, { pending: new Set([last]), flushed: true }), last), "lost");
});

test("only images well before the cursor are skipped", () => {
  const image = index.images[400];
  assert.ok(skippable(index, 380, image));
  assert.ok(!skippable(index, 395, image));
  assert.ok(!skippable(index, 400, image));
});
