import test from "node:test";
import assert from "node:assert/strict";
import {
  cutSegments,
  cutWindow,
  findMessage,
  foldColumns,
  joinColumns,
  joinSegments,
} from "../js/offline/windows.js";

const columns = (rows) => ({
  t: Float64Array.from(rows, ([t]) => t),
  min: Float64Array.from(rows, ([, v]) => v),
  max: Float64Array.from(rows, ([, v]) => v),
  last: Float64Array.from(rows, ([, v]) => v),
  n: new Float64Array(rows.length).fill(1),
  count: rows.length,
  raw: true,
});

test("parts of a line are joined, and points that they share are in it once", () => {
  const a = { base: 10, columns: columns([[0, 1], [5, 2], [9, 3]]) }; // prettier-ignore
  const b = { base: 15, columns: columns([[0, 2], [4, 3], [8, 4]]) }; // prettier-ignore
  const joined = joinColumns([a, b]);
  assert.deepEqual([...joined.t], [10, 15, 19, 23]);
  assert.deepEqual([...joined.last], [1, 2, 3, 4]);
});

test("a window has the points within it and one on each side", () => {
  const line = columns([0, 10, 20, 30, 40].map((t) => [t, t]));
  assert.deepEqual([...cutWindow(line, 15, 30, 1).t], [10, 20, 30]);
  assert.deepEqual([...cutWindow(line, 12, 13, 1).t], [10, 20]);
  assert.equal(cutWindow(line, -9, 99, 1).count, 5);
  assert.equal(cutWindow(columns([]), 0, 9, 1).count, 0);
});

test("bins keep the lowest, highest and last value and the number of messages", () => {
  const folded = foldColumns(columns([[0, 5], [1, -7], [2, 6], [8, NaN], [9, 1], [16, NaN]]), 8); // prettier-ignore
  assert.deepEqual([...folded.t], [0, 8, 16]);
  assert.deepEqual([...folded.min], [-7, 1, NaN]);
  assert.deepEqual([...folded.max], [6, 1, NaN]);
  assert.deepEqual([...folded.last], [6, 1, NaN]);
  assert.deepEqual([...folded.n], [3, 2, 1]);
});

test("many points are summarized, and the extremes of a random line survive", () => {
  let seed = 7;
  const next = () => (seed = (seed * 48271) % 2147483647) / 2147483647;
  const rows = Array.from({ length: 30_000 }, (_, i) => [i * 3, next()]);
  rows[12_345][1] = 99;
  const cut = cutWindow(columns(rows), 0, 90_000, 256);
  assert.equal(cut.raw, false);
  assert.ok(cut.count < 400);
  assert.equal(Math.max(...cut.max), 99);
  assert.equal(
    cut.n.reduce((a, b) => a + b, 0),
    30_000,
  );
});

test("a state that continues in the next part is one segment, a text is not", () => {
  const rows = (cls) => [
    { base: 0, rows: [[0, 5, "a", cls]] },
    { base: 5, rows: [[0, 5, "a", cls], [5, null, "b", cls]] }, // prettier-ignore
  ];
  assert.deepEqual(joinSegments(rows("state")), [
    [0, 10, "a", "state", ""],
    [10, null, "b", "state", ""],
  ]);
  assert.equal(joinSegments(rows("text")).length, 3);
});

test("segments that are too short to be seen are counted", () => {
  const rows = Array.from({ length: 4_000 }, (_, i) => [i, i + 1, i % 2 ? "x" : "y", "state", ""]);
  rows.push([4_000, 9_000, "z", "state", ""]);
  const cut = cutSegments(rows, 0, 9_000, 100);
  assert.equal(cut.at(-1)[2], "z");
  assert.ok(cut.length < 60);
  assert.ok(cut.slice(0, -1).every(([, , label, cls]) => cls === "many" && label.endsWith("changes")));
  assert.deepEqual(
    cutSegments(rows, 2, 3.5, 100).map(([a]) => a),
    [1, 2, 3],
  );
});

test("the message at the cursor is the last one before it, or a nearer one within reach", () => {
  const times = [0, 100, 200];
  assert.equal(findMessage(times, -1), -1);
  assert.equal(findMessage(times, 199), 1);
  assert.equal(findMessage(times, 200), 2);
  assert.equal(findMessage(times, 160, { past: 50 }), -1);
  assert.equal(findMessage(times, 160, { past: 50, future: 45 }), 2);
  assert.equal(findMessage(times, 140, { future: 100 }), 1);
});
