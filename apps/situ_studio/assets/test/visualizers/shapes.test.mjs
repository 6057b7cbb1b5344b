import { test } from "node:test";
import assert from "node:assert/strict";
import { imageMapping, shapesAt } from "../../js/visualizers/shapes.js";

const shapes = {
  rects: [
    [0, 0, 100, 100, "person", 0.71234, 3],
    [20, 20, 10, 10, "face", null, null],
    [50, 50, 5, 5, null, null, 0],
  ],
  points: [
    [80, 80, "nose"],
    [83, 80, null],
  ],
};

test("the smallest rectangle around a position is described with label, score and id", () => {
  assert.deepEqual(shapesAt(shapes, 60, 40, 1), ["person", "score 0.7123", "id 3", "100 × 100 at (0, 0)"]);
  assert.deepEqual(shapesAt(shapes, 25, 25, 1), ["face", "10 × 10 at (20, 20)"]);
  assert.deepEqual(shapesAt(shapes, 52, 52, 1), ["rectangle", "id 0", "5 × 5 at (50, 50)"]);
});

test("the nearest point within a few screen pixels is described before its rectangle", () => {
  assert.equal(shapesAt(shapes, 81, 80, 1)[0], "nose  (80, 80)");
  assert.equal(shapesAt(shapes, 82.5, 80, 1)[0], "point  (83, 80)");
  assert.equal(shapesAt(shapes, 78, 80, 10)[0], "person", "too far away on the screen when zoomed in");
});

test("empty positions and other shapes are not described", () => {
  assert.deepEqual(shapesAt(shapes, 500, 500, 1), []);
  assert.deepEqual(shapesAt({ texts: ["x"] }, 1, 1, 1), []);
});

test("positions convert to the canvas and back, mirrored or not", () => {
  for (const mirrored of [false, true]) {
    const map = imageMapping({ x: 10, y: 20, k: 2, width: 64 }, mirrored);
    assert.deepEqual(map.back(map.x(5), map.y(7)), [5, 7]);
  }
  assert.equal(
    imageMapping({ x: 10, y: 0, k: 2, width: 64 }, true).x(0),
    138,
    "the left edge of a mirrored image is on the right",
  );
});
