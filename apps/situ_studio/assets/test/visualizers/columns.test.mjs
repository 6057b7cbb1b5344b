// Each column of pixels is drawn from the minimum to the maximum of its messages.
import test from "node:test";
import assert from "node:assert/strict";
import { pixelColumns, strokeSpan } from "../../js/visualizers/columns.js";
import { Series } from "../../js/data/series.js";
import { binWidth } from "../../js/data/window.js";

function randomNumbers(seed) {
  return () => (seed = (seed * 48271) % 2147483647) / 2147483647;
}

// Folds messages [t, v] into bins as the server does; the times are those of the bins' starts.
function foldRows(rows, bin) {
  const bins = new Map();
  for (const [t, v] of rows) {
    const start = Math.floor(t / bin) * bin;
    const b = bins.get(start) ?? { t: start, min: Infinity, max: -Infinity, n: 0 };
    bins.set(start, { t: start, min: Math.min(b.min, v), max: Math.max(b.max, v), last: v, n: b.n + 1 });
  }
  const all = [...bins.values()];
  const frame = { count: all.length, raw: false };
  for (const c of ["t", "min", "max", "last", "n"]) frame[c] = Float64Array.from(all, (b) => b[c]);
  const s = new Series();
  s.putFrame(frame, 0, -Infinity, bin);
  return s;
}

const findExtremes = (rows, from, to) => {
  let [lo, hi] = [Infinity, -Infinity];
  for (const [t, v] of rows) if (t >= from && t < to) [lo, hi] = [Math.min(lo, v), Math.max(hi, v)];
  return [lo, hi];
};

test("each column ranges from the minimum to the maximum of its messages, within a pixel", () => {
  const next = randomNumbers(20260731);
  for (let round = 0; round < 8; round++) {
    const n = 3000 + Math.floor(next() * 3000),
      px = 150 + Math.floor(next() * 300);
    const rows = Array.from({ length: n }, (_, i) => [
      i * 1000 + Math.floor(next() * 900),
      next() < 0.002 ? 50 * (next() - 0.5) : Math.sin(i / 300) + 0.1 * next(),
    ]);
    const width = n * 1000 * (0.4 + 0.6 * next()),
      from = next() * (n * 1000 - width);
    const s = foldRows(rows, binWidth(width, px));
    const offset = next();
    const x = (t) => offset + ((t - from) / width) * px;
    const columnTime = (c) => from + ((c - offset) / px) * width;
    const a = Math.max(s.indexAt(from), 0),
      b = Math.min(s.indexAt(from + width) + 1, s.length - 1);
    const { left, lo, hi } = pixelColumns(s, a, b, x, 1, px - 1);
    for (let k = 0; k < lo.length; k++) {
      const c = left + k;
      const [least, most] = findExtremes(rows, columnTime(c), columnTime(c + 1));
      if (least > most) continue;
      assert.ok(lo[k] <= least && hi[k] >= most, `column ${c}: ${lo[k]}..${hi[k]} holds ${least}..${most}`);
      const [under, over] = findExtremes(rows, columnTime(c - 1), columnTime(c + 2));
      assert.ok(lo[k] >= under && hi[k] <= over, `column ${c}: ${lo[k]}..${hi[k]} is within ${under}..${over}`);
    }
  }
});

test("neighbors touch, lines cross empty columns, and nothing crosses a gap", () => {
  const step = foldRows([0, 1, 2, 3, 4, 5, 6, 7].map((i) => [i * 10, i < 4 ? 0 : 9]).concat([[75, 9]]), 10);
  const { lo, hi, joins } = pixelColumns(step, 0, step.length - 1, (t) => t / 10, 0, 8);
  assert.deepEqual([...lo], [0, 0, 0, 0, 0, 9, 9, 9]);
  assert.deepEqual([...hi], [0, 0, 0, 0, 9, 9, 9, 9]);
  assert.deepEqual(joins, []);
  const apart = foldRows(
    [0, 30, 60, 90].flatMap((t, i) => [
      [t, i],
      [t + 1, i],
    ]),
    10,
  );
  assert.deepEqual(pixelColumns(apart, 0, 3, (t) => t / 10, 0, 10).joins, [
    [0, 0, 3, 1],
    [3, 1, 6, 2],
    [6, 2, 9, 3],
  ]);
  const some = Array.from({ length: 40 }, (_, i) => (i < 20 ? i : 70 + i));
  const hole = foldRows(
    some.flatMap((i) => [
      [i * 10, i],
      [i * 10 + 5, i],
    ]),
    10,
  );
  const found = pixelColumns(hole, 0, hole.length - 1, (t) => t / 10, 0, 110);
  assert.deepEqual(found.joins, []);
  assert.ok([...found.lo.slice(20, 90)].every(Number.isNaN));
  assert.ok([...found.lo.slice(0, 20), ...found.lo.slice(90)].every(Number.isFinite));
});

test("a stroke covers every pixel that its values touch, and at least one", () => {
  assert.deepEqual(strokeSpan(10.2, 12.7, 1), [10, 3]);
  assert.deepEqual(strokeSpan(10, 10, 1), [10, 1]);
  assert.deepEqual(strokeSpan(10.5, 10.5, 1), [10, 1]);
  assert.deepEqual(strokeSpan(10.5, 10.5, 3), [9, 3]);
});
