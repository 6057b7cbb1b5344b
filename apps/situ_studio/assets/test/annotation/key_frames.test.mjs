import assert from "node:assert/strict";
import test from "node:test";
import {
  boxBetween,
  dragPart,
  findGrip,
  listKeyFrames,
  positionAt,
  spatialKind,
} from "../../js/annotation/key_frames.js";

const numberAttribute = (name) => ({ name, kind: "number" });

test("attributes determine whether a stream has boxes, points or neither", () => {
  assert.equal(spatialKind(["x", "y", "width", "height"].map(numberAttribute)), "box");
  assert.equal(spatialKind(["x", "y", "score"].map(numberAttribute)), "point");
  assert.equal(spatialKind([{ name: "x", kind: "text" }, numberAttribute("y")]), null);
});

test("positions are interpolated between two key frames, and missing outside of them", () => {
  const annotationAt = (t, x, y) => ({ id: t, from: t, to: t, track: "car", values: { x, y } });
  const items = [annotationAt(200, 10, 20), annotationAt(100, 0, 0), annotationAt(100, 5, 5)].slice(0, 2);
  const frames = listKeyFrames([...items, { ...annotationAt(150, 9, 9), track: "dog" }], "car", "point");
  assert.deepEqual(positionAt(frames, 150), { place: [5, 10], key: false });
  assert.deepEqual(positionAt(frames, 200), { place: [10, 20], key: true });
  assert.equal(positionAt(frames, 99), null);
  assert.equal(positionAt(frames, 201), null);
  assert.equal(positionAt([], 1), null);
});

test("a box may start at any corner and stays within the image", () => {
  assert.deepEqual(boxBetween([30, 40], [10, 20], 64, 48), [10, 20, 20, 20]);
  assert.deepEqual(boxBetween([-5, 40], [70, 60], 64, 48), [0, 40, 64, 8]);
});

test("dragging a corner resizes a box, dragging its inside moves it", () => {
  const box = [10, 10, 20, 20];
  assert.equal(findGrip(box, [11, 9], 3), 0);
  assert.equal(findGrip(box, [30, 30], 3), 2);
  assert.equal(findGrip(box, [20, 20], 3), "all");
  assert.equal(findGrip(box, [40, 20], 3), null);
  assert.deepEqual(dragPart(box, "all", [20, 20], [25, 22], 64, 48), [15, 12, 20, 20]);
  assert.deepEqual(dragPart(box, 2, [30, 30], [40, 35], 64, 48), [10, 10, 30, 25]);
  assert.deepEqual(dragPart(box, 0, [10, 10], [35, 5], 64, 48), [30, 5, 5, 25]);
});
