import { test } from "node:test";
import assert from "node:assert/strict";
import { FrameCache } from "../../js/video/frame_cache.js";

const closed = [];
const frame = (n) => ({ n, close: () => closed.push(n) });

test("the images furthest from the cursor are closed, but never the one that is shown", () => {
  closed.length = 0;
  const cache = new FrameCache(50);
  cache.center = 10;
  cache.shown = 2;
  for (const n of [2, 8, 9, 10, 11]) cache.put(n, frame(n), 10);
  assert.deepEqual(closed, []);
  cache.put(12, frame(12), 10);
  assert.deepEqual(closed, [8], "2 is further, but shown");
  cache.shown = 10;
  cache.put(13, frame(13), 10);
  assert.deepEqual(closed, [8, 2]);
  assert.equal(cache.bytes, 50);
});

test("an image that is put again replaces the first", () => {
  closed.length = 0;
  const cache = new FrameCache(50);
  cache.put(1, frame("a"), 20);
  cache.put(1, frame("b"), 30);
  assert.deepEqual([closed, cache.bytes, cache.get(1).n], [["a"], 30, "b"]);
  cache.clear();
  assert.deepEqual([closed, cache.bytes, cache.get(1)], [["a", "b"], 0, null]);
});

test("a single image larger than the limit is kept", () => {
  const cache = new FrameCache(50);
  cache.put(1, frame(1), 500);
  assert.ok(cache.has(1));
});

test("the nearest held image", () => {
  const cache = new FrameCache(500);
  for (const n of [3, 9, 20]) cache.put(n, frame(n), 1);
  assert.deepEqual([cache.nearest(12, 0, 99), cache.nearest(16, 0, 99), cache.nearest(12, 10, 15)], [9, 20, -1]);
});

test("random use never exceeds the limit, and closes every image once", () => {
  const alive = new Set();
  let seed = 7;
  const random = (n) => (seed = (seed * 1103515245 + 12345) % 2147483648) % n;
  const cache = new FrameCache(1000);
  for (let i = 0; i < 5000; i++) {
    cache.center = random(300);
    cache.shown = cache.nearest(cache.center, 0, 300);
    const image = { close: () => assert.ok(alive.delete(image)) };
    alive.add(image);
    cache.put(random(300), image, 10 + random(40));
    assert.ok(cache.bytes <= 1000 + 50);
    assert.equal(alive.size, cache.frames.size);
  }
  cache.clear();
  assert.equal(alive.size, 0);
});
