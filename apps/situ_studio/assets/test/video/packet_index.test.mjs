import { test } from "node:test";
import assert from "node:assert/strict";
import { PacketIndex, readColumns } from "../../js/video/packet_index.js";

// Builds an index from rows [time, size, flags] in decoding order.
export const indexOf = (rows) =>
  new PacketIndex({
    times: Float64Array.from(rows, (r) => r[0]),
    sizes: Uint32Array.from(rows, (r) => r[1]),
    flags: Uint8Array.from(rows, (r) => r[2]),
  });

// Two groups of images with B-frames at uneven times; the first packet is decoded but not shown.
const index = indexOf([
  [0, 90, 3],
  [10, 50, 0],
  [40, 40, 0],
  [20, 10, 0],
  [35, 10, 0],
  [50, 90, 1],
  [90, 40, 0],
  [60, 10, 0],
]);

test("images are in the order of their times, and packets in that of the decoder", () => {
  assert.deepEqual([...index.times], [10, 20, 35, 40, 50, 60, 90]);
  assert.deepEqual([...index.packets], [1, 3, 4, 2, 5, 7, 6]);
  assert.deepEqual([...index.images], [-1, 0, 3, 1, 2, 4, 6, 5]);
});

test("the image at a time is the last one at or before it", () => {
  const images = [9, 10, 19, 20, 34, 35, 49, 50, 1e9].map((t) => index.imageAt(t));
  assert.deepEqual(images, [-1, 0, 0, 1, 1, 2, 3, 4, 6]);
});

test("an image is shown for a while after and before its time, and the nearer one of two", () => {
  assert.equal(index.imageAt(95, 4), -1);
  assert.equal(index.imageAt(94, 4), 6);
  assert.equal(index.imageAt(5, Infinity, 4), -1);
  assert.equal(index.imageAt(6, Infinity, 4), 0);
  assert.equal(index.imageAt(16, Infinity, 10), 1);
  assert.equal(index.imageAt(15, Infinity, 10), 0, "the earlier one of two that are equally near");
});

test("a decoder starts at the key frame before an image", () => {
  assert.deepEqual(
    [0, 4, 5, 7].map((p) => index.keyBefore(p)),
    [0, 0, 5, 5],
  );
  assert.deepEqual([index.keyAfter(0), index.keyAfter(5)], [5, 8]);
  const other = indexOf([
    [0, 1, 1],
    [1, 1, 1],
    [2, 1, 0],
  ]);
  other.dropKey(1);
  assert.equal(other.keyBefore(2), 0);
});

test("parts cover all packets once, and large groups begin with a small part", () => {
  const rows = [];
  for (let p = 0; p < 900; p++) rows.push([p, 20_000 + ((p * 7919) % 5000), p % 300 === 0 ? 1 : 0]);
  const large = indexOf(rows);
  let next = 0;
  for (let p = 0; p < 900; p++) {
    const [first, end] = large.partOf(p);
    assert.ok(first <= p && p < end);
    if (p < next) continue;
    assert.equal(first, next);
    const bytes = large.sizes.subarray(first, end).reduce((a, b) => a + b, 0);
    assert.ok(bytes <= 1_100_000, `${bytes} bytes from ${first}`);
    if (p % 300 === 0) assert.ok(bytes <= 300_000, "the first part of a group");
    next = end;
  }
  assert.equal(next, 900);
});

test("the columns of the server are read exactly, and damaged ones are refused", () => {
  const count = 3;
  const buffer = new ArrayBuffer(count * 13);
  new BigInt64Array(buffer, 0, count).set([0n, 40_000_000_000_001n, -20n]);
  new Uint32Array(buffer, 24, count).set([7, 8, 9]);
  new Uint8Array(buffer, 36, count).set([1, 0, 2]);
  const { times, sizes, flags } = readColumns(buffer, count);
  assert.deepEqual([...times], [0, 40_000_000_000_001, 39_999_999_999_981]);
  assert.deepEqual([...sizes, ...flags], [7, 8, 9, 1, 0, 2]);
  assert.throws(() => readColumns(buffer, 4), /damaged/);
});

test("an empty stream has no image", () => {
  const none = indexOf([]);
  assert.deepEqual([none.imageCount, none.imageAt(5), none.parts.length], [0, -1, 0]);
});
