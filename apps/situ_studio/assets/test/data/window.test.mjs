import test from "node:test";
import assert from "node:assert/strict";
import { planWindow, binWidth } from "../../js/data/window.js";
import { Series } from "../../js/data/series.js";

const data = [0, 1000e9];

test("bins are powers of two and at most a pixel wide", () => {
  const w = binWidth(60e9, 1000);
  assert.equal(Math.log2(w) % 1, 0);
  assert.ok(w <= 60e6 && w > 30e6);
});

test("held data are not requested again while panning within them", () => {
  const first = planWindow(null, [100e9, 200e9], 1000, data, false);
  assert.ok(first.from <= 50e9 && first.to >= 250e9);
  const held = { ...first, head: data[1] };
  assert.equal(planWindow(held, [130e9, 230e9], 1000, data, false), null);
  assert.notEqual(planWindow(held, [180e9, 280e9], 1000, data, false), null);
  assert.notEqual(planWindow(held, [100e9, 120e9], 1000, data, false), null, "another zoom level has other bins");
});

test("a window that covers all data is sufficient", () => {
  const first = planWindow(null, [-100e9, 1100e9], 1000, data, false);
  assert.equal(planWindow({ ...first, head: 1000e9 }, [-300e9, 900e9], 1000, data, false), null);
});

test("while the data grow, only the new part is requested", () => {
  const held = { ...planWindow(null, [970e9, 1000e9], 1000, data, true), head: 1000e9 };
  const next = planWindow(held, [971e9, 1001e9], 1000, [0, 1001e9], true);
  assert.equal(next.append, true);
  assert.ok(next.from >= 999e9 && next.from <= 1000e9);
});

test("a series replaces its tail and finds the value at a time", () => {
  const columnFrame = (t, v) => ({
    count: t.length,
    raw: true,
    t: Float64Array.from(t),
    min: Float64Array.from(v),
    max: Float64Array.from(v),
    last: Float64Array.from(v),
    n: Float64Array.from(v),
  });
  const s = new Series();
  s.putFrame(columnFrame([0, 10, 20, 30], [1, 2, 3, 4]), 100);
  s.putFrame(columnFrame([-10, 0, 10], [7, 9, 8]), 120, 120);
  assert.deepEqual(Array.from(s.t.subarray(0, s.length)), [100, 110, 120, 130]);
  assert.equal(s.last[s.indexAt(125)], 9);
  assert.equal(s.indexAt(99), -1);
  assert.deepEqual(s.valueExtent(100, 130), [1, 9]);
});

test("a stream that lags is requested from its own newest message", () => {
  const view = [70e9, 100e9],
    bin = binWidth(30e9, 600);
  const held = { from: 70e9, to: 120e9, bin, head: 95e9, newest: 82e9 };
  const next = planWindow(held, view, 600, [0, 96e9], true);
  assert.ok(next.append);
  assert.ok(next.from <= 82e9 && next.from > 82e9 - 3 * bin, `from ${next.from}`);
  const none = planWindow({ ...held, newest: -Infinity }, view, 600, [0, 96e9], true);
  assert.equal(none.from, held.from, "a stream without messages: the whole window");
  const ahead = planWindow({ ...held, newest: undefined }, view, 600, [0, 96e9], true);
  assert.ok(ahead.from <= 95e9 && ahead.from > 95e9 - 3 * bin, "otherwise from the previous end of the data");
});
