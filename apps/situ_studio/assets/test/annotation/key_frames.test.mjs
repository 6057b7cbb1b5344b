import assert from "node:assert/strict";
import test from "node:test";
import { boxOf, dragged, grip, keyFrames, placeAt, spatialKind } from "../../js/annotation/key_frames.js";

const number = (name) => ({ name, kind: "number" });

test("the attributes tell boxes from points from neither", () => {
  assert.equal(spatialKind(["x", "y", "width", "height"].map(number)), "box");
  assert.equal(spatialKind(["x", "y", "score"].map(number)), "point");
  assert.equal(spatialKind([{ name: "x", kind: "text" }, number("y")]), null);
});

test("between two key frames a place lies on the line, outside there is none", () => {
  const at = (t, x, y) => ({ id: t, from: t, to: t, track: "car", values: { x, y } });
  const items = [at(200, 10, 20), at(100, 0, 0), at(100, 5, 5)].slice(0, 2);
  const frames = keyFrames([...items, { ...at(150, 9, 9), track: "dog" }], "car", "point");
  assert.deepEqual(placeAt(frames, 150), { place: [5, 10], key: false });
  assert.deepEqual(placeAt(frames, 200), { place: [10, 20], key: true });
  assert.equal(placeAt(frames, 99), null);
  assert.equal(placeAt(frames, 201), null);
  assert.equal(placeAt([], 1), null);
});

test("any corner may be the first, and a box stays in the picture", () => {
  assert.deepEqual(boxOf([30, 40], [10, 20], 64, 48), [10, 20, 20, 20]);
  assert.deepEqual(boxOf([-5, 40], [70, 60], 64, 48), [0, 40, 64, 8]);
});

test("a corner resizes, the inside moves", () => {
  const box = [10, 10, 20, 20];
  assert.equal(grip(box, [11, 9], 3), 0);
  assert.equal(grip(box, [30, 30], 3), 2);
  assert.equal(grip(box, [20, 20], 3), "all");
  assert.equal(grip(box, [40, 20], 3), null);
  assert.deepEqual(dragged(box, "all", [20, 20], [25, 22], 64, 48), [15, 12, 20, 20]);
  assert.deepEqual(dragged(box, 2, [30, 30], [40, 35], 64, 48), [10, 10, 30, 25]);
  assert.deepEqual(dragged(box, 0, [10, 10], [35, 5], 64, 48), [30, 5, 5, 25]);
});
