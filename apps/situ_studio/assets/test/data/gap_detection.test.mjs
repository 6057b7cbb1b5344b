import test from "node:test";
import assert from "node:assert/strict";
import { Series } from "../../js/data/series.js";

const MS = 1e6,
  S = 1e9;

function buildSeries(times, n = 1, raw = true) {
  const s = new Series();
  const column = Float64Array.from(times, () => 0);
  const count = Float64Array.from(times, () => n);
  s.putFrame(
    { t: Float64Array.from(times), min: column, max: column, last: column, n: count, count: times.length, raw },
    0,
  );
  return s;
}

const everyStep = (step, from, to) =>
  Array.from({ length: Math.round((to - from) / step) }, (_, i) => from + i * step);
const findGaps = (s) =>
  Array.from({ length: s.length }, (_, i) => i)
    .filter((i) => i > 0 && s.hasGapBefore(i))
    .map((i) => s.t[i]);

test("a gap in regular data is detected at every scale", () => {
  const times = [...everyStep(10 * MS, 0, 5 * S), ...everyStep(10 * MS, 12 * S, 20 * S)];
  assert.deepEqual(findGaps(buildSeries(times)), [12 * S]);
  // the same in bins of 1 s with 100 messages each
  assert.deepEqual(
    findGaps(
      buildSeries(
        [0, 1, 2, 3, 4, 12, 13, 14, 15, 16, 17, 18, 19].map((x) => x * S),
        100,
        false,
      ),
    ),
    [12 * S],
  );
});

test("a live series joins older bins of many messages, and has its gaps", () => {
  const s = buildSeries(everyStep(32 * MS, 0, 3200 * MS), 16, false);
  const putTimes = (times) => {
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
    s.putFrame(frame, 0, times[0]);
  };
  putTimes(everyStep(2 * MS, 3200 * MS, 5 * S));
  assert.deepEqual(findGaps(s), []);
  putTimes(everyStep(2 * MS, 5.2 * S, 6 * S));
  assert.deepEqual(findGaps(s), [5.2 * S]);
});

test("two missing messages or jitter are not a gap", () => {
  const times = everyStep(10 * MS, 0, 5 * S)
    .filter((_, i) => i !== 100 && i !== 101)
    .map((t, i) => t + (i % 3) * MS);
  assert.deepEqual(findGaps(buildSeries(times)), []);
});

test("irregular data have no gaps", () => {
  let t = 0,
    seed = 7;
  const times = Array.from({ length: 300 }, () => {
    seed = (seed * 48271) % 2147483647;
    return (t += -Math.log(seed / 2147483647) * S);
  });
  assert.deepEqual(findGaps(buildSeries(times)), []);
});

test("a value is old when the next message is overdue", () => {
  const s = buildSeries([...everyStep(10 * MS, 0, 5 * S), ...everyStep(10 * MS, 12 * S, 20 * S)]);
  assert.equal(s.messageAge(s.indexAt(4 * S + 5 * MS), 4 * S + 5 * MS), 0);
  const i = s.indexAt(8 * S);
  assert.equal(s.messageAge(i, 8 * S), 8 * S - s.t[i]);
  assert.equal(buildSeries([0, 3 * S, 10 * S]).messageAge(1, 3.5 * S), 0);
  assert.equal(buildSeries([0, 3 * S, 10 * S]).messageAge(1, 6 * S), 3 * S);
});
