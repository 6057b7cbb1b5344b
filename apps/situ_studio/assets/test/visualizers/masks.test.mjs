// Masks: runs are decoded, and classes cover the part of the image that the network saw.
import { test } from "node:test";
import assert from "node:assert/strict";
import { coveredRect, shadeColor, unpackRuns } from "../../js/visualizers/masks.js";

test("runs start at the upper left corner, and excess values are dropped", () => {
  const { values } = unpackRuns({ width: 2, height: 2, runs: [0, 1, 7, 3] });
  assert.deepEqual([...values], [0, 7, 7, 7]);
  assert.deepEqual([...unpackRuns({ width: 2, height: 1, runs: [3, 99] }).values], [3, 3]);
});

test("a square network saw the square around the image or its center", () => {
  const picture = { width: 160, height: 120 };
  assert.deepEqual(coveredRect({ width: 32, height: 32 }, picture), [0, -20, 160, 160]);
  assert.deepEqual(coveredRect({ width: 32, height: 32 }, picture, "crop"), [20, 0, 120, 120]);
  assert.deepEqual(coveredRect({ width: 32, height: 32 }, picture, "whole"), [0, 0, 160, 120]);
  assert.deepEqual(coveredRect({ width: 64, height: 48 }, picture), [0, 0, 160, 120]);
});

test("the colors of 32 classes differ", () => {
  const colors = Array.from({ length: 8 }, (_, i) => [60 + 20 * i, 100, 50, 255]);
  const shades = Array.from({ length: 32 }, (_, i) => shadeColor(colors[i % 8], i).join());
  assert.equal(new Set(shades).size, 32);
  assert.deepEqual(shadeColor([200, 100, 50, 255], 8), [120, 60, 30, 255]);
});
