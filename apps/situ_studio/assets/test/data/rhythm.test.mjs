import test from "node:test";
import assert from "node:assert/strict";
import { Series } from "../../js/data/series.js";

const MS = 1e6,
  S = 1e9;

function series(times, n = 1, raw = true) {
  const s = new Series();
  const column = Float64Array.from(times, () => 0);
  const count = Float64Array.from(times, () => n);
  s.put(
    { t: Float64Array.from(times), min: column, max: column, last: column, n: count, count: times.length, raw },
    0,
  );
  return s;
}

const every = (step, from, to) => Array.from({ length: Math.round((to - from) / step) }, (_, i) => from + i * step);
const holes = (s) =>
  Array.from({ length: s.length }, (_, i) => i)
    .filter((i) => i > 0 && s.holeBefore(i))
    .map((i) => s.t[i]);

test("a hole in what comes regularly is one, at every scale", () => {
  const times = [...every(10 * MS, 0, 5 * S), ...every(10 * MS, 12 * S, 20 * S)];
  assert.deepEqual(holes(series(times)), [12 * S]);
  // the same in bins of 1 s with 100 messages each
  assert.deepEqual(
    holes(
      series(
        [0, 1, 2, 3, 4, 12, 13, 14, 15, 16, 17, 18, 19].map((x) => x * S),
        100,
        false,
      ),
    ),
    [12 * S],
  );
});

test("what grows live joins older bins of many messages, and has its holes", () => {
  const s = series(every(32 * MS, 0, 3200 * MS), 16, false);
  const put = (times) => {
    const column = Float64Array.from(times, () => 0);
    const n = Float64Array.from(times, () => 1);
    const frame = {
      t: Float64Array.from(times),
      min: column,
      max: column,
      last: column,
      n,
      count: n.length,
      raw: true,
    };
    s.put(frame, 0, times[0]);
  };
  put(every(2 * MS, 3200 * MS, 5 * S));
  assert.deepEqual(holes(s), []);
  put(every(2 * MS, 5.2 * S, 6 * S));
  assert.deepEqual(holes(s), [5.2 * S]);
});

test("two messages missed are no hole, nor is jitter", () => {
  const times = every(10 * MS, 0, 5 * S)
    .filter((_, i) => i !== 100 && i !== 101)
    .map((t, i) => t + (i % 3) * MS);
  assert.deepEqual(holes(series(times)), []);
});

test("what comes as it likes has no holes", () => {
  let t = 0,
    seed = 7;
  const times = Array.from({ length: 300 }, () => {
    seed = (seed * 48271) % 2147483647;
    return (t += -Math.log(seed / 2147483647) * S);
  });
  assert.deepEqual(holes(series(times)), []);
});

test("a value is old when its successor is overdue", () => {
  const s = series([...every(10 * MS, 0, 5 * S), ...every(10 * MS, 12 * S, 20 * S)]);
  assert.equal(s.age(s.at(4 * S + 5 * MS), 4 * S + 5 * MS), 0);
  const i = s.at(8 * S);
  assert.equal(s.age(i, 8 * S), 8 * S - s.t[i]);
  assert.equal(series([0, 3 * S, 10 * S]).age(1, 3.5 * S), 0);
  assert.equal(series([0, 3 * S, 10 * S]).age(1, 6 * S), 3 * S);
});
