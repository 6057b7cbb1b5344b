// Masks: runs become values, and classes lie over the part of the picture that the network saw.
import { test } from "node:test";
import assert from "node:assert/strict";
import { covered, shade, unpack } from "../../js/visualizers/masks.js";

test("runs are values from the upper left corner on; what is too long is cut", () => {
  const { values } = unpack({ width: 2, height: 2, runs: [0, 1, 7, 3] });
  assert.deepEqual([...values], [0, 7, 7, 7]);
  assert.deepEqual([...unpack({ width: 2, height: 1, runs: [3, 99] }).values], [3, 3]);
});

test("a square network saw the square around the picture, or that in its middle", () => {
  const picture = { width: 160, height: 120 };
  assert.deepEqual(covered({ width: 32, height: 32 }, picture), [0, -20, 160, 160]);
  assert.deepEqual(covered({ width: 32, height: 32 }, picture, "crop"), [20, 0, 120, 120]);
  assert.deepEqual(covered({ width: 32, height: 32 }, picture, "whole"), [0, 0, 160, 120]);
  assert.deepEqual(covered({ width: 64, height: 48 }, picture), [0, 0, 160, 120]);
});

test("the colours of 32 classes differ", () => {
  const colors = Array.from({ length: 8 }, (_, i) => [60 + 20 * i, 100, 50, 255]);
  const shades = Array.from({ length: 32 }, (_, i) => shade(colors[i % 8], i).join());
  assert.equal(new Set(shades).size, 32);
  assert.deepEqual(shade([200, 100, 50, 255], 8), [120, 60, 30, 255]);
});
