import test from "node:test";
import assert from "node:assert/strict";
import { reduce, initial, createStore, width } from "../../js/time/view.js";

const s0 = initial(0, 100e9);
const run = (s, ...actions) => actions.reduce(reduce, s);

test("zooming about a time keeps that time's place in the view", () => {
  const s = run(s0, { type: "zoomAt", t: 25e9, factor: 0.5 });
  assert.deepEqual(s.view, [12.5e9, 62.5e9]);
  assert.equal((25e9 - s.view[0]) / width(s.view), 0.25);
});

test("some data always stays in the view", () => {
  const s = run(s0, { type: "pan", by: 1e15 });
  assert.ok(s.view[0] < s.data[1]);
  const z = run(s0, { type: "zoom", factor: 1e6 });
  assert.equal(width(z.view), 1000e9);
});

test("a selection end before its start opens the other end", () => {
  const s = run(s0, { type: "selStart", t: 10e9 }, { type: "selEnd", t: 5e9 });
  assert.deepEqual(s.sel, [null, 5e9]);
  const z = run(s0, { type: "selStart", t: 10e9 }, { type: "selEnd", t: 30e9 }, { type: "zoomSel" });
  assert.deepEqual(z.view, [9e9, 31e9]);
});

test("a shifted selection stays within the data and in view", () => {
  const a = run(s0, { type: "select", from: 10e9, to: 30e9 }, { type: "zoomSel" }, { type: "shiftSel", dir: 1 });
  assert.deepEqual(a.sel, [30e9, 50e9]);
  assert.ok(a.view[0] <= 30e9 && a.view[1] >= 50e9);
  const b = run(a, { type: "shiftSel", dir: 9 });
  assert.deepEqual(b.sel, [80e9, 100e9]);
});

test("playback runs at its speed, stops at the end, or starts again when repeated", () => {
  let s = run(s0, { type: "speed", value: 4 }, { type: "play", from: 90e9, to: 100e9 });
  s = run(s, { type: "tick", elapsed: 1e9 });
  assert.equal(s.cursor, 94e9);
  const stopped = run(s, { type: "tick", elapsed: 9e9 });
  assert.equal(stopped.mode, "manual");
  assert.equal(stopped.cursor, 100e9);
  const again = run(s, { type: "repeat" }, { type: "tick", elapsed: 9e9 });
  assert.equal(again.mode, "play");
  assert.equal(again.cursor, 90e9);
});

test("live follows the newest time with the cursor at 80 % of a 30 s view", () => {
  let s = run(s0, { type: "live", on: true }, { type: "data", from: 0, to: 200e9 });
  assert.deepEqual(s.view, [176e9, 206e9]);
  assert.equal(s.cursor, 200e9);
  s = run(s, { type: "zoomAt", t: 0, factor: 0.5 });
  assert.equal(width(s.view), 15e9);
  s = run(s, { type: "live", on: false }, { type: "data", from: 0, to: 300e9 });
  assert.equal(s.cursor, 200e9);
});

test("the mouse moves the cursor only in manual mode and while following", () => {
  assert.equal(run(s0, { type: "move", t: 5 }).cursor, 5);
  assert.equal(run(s0, { type: "follow" }, { type: "move", t: 5 }).cursor, 0);
  assert.equal(run(s0, { type: "play", from: 0, to: 9 }, { type: "move", t: 5 }).cursor, 0);
});

test("go to time centres the view within the data and holds the cursor", () => {
  const s = run(s0, { type: "view", from: 0, to: 10e9 }, { type: "goto", t: 50e9 });
  assert.deepEqual(s.view, [45e9, 55e9]);
  assert.equal(run(s, { type: "move", t: 5 }).cursor, 50e9);
});

test("random actions keep the invariants", () => {
  let seed = 7;
  const rnd = () => (seed = (seed * 1103515245 + 12345) % 2147483648) / 2147483648;
  const acts = [
    () => ({ type: "zoomAt", t: rnd() * 100e9, factor: 0.2 + 2 * rnd() }),
    () => ({ type: "pan", by: (rnd() - 0.5) * 300e9 }),
    () => ({ type: "selStart", t: rnd() * 100e9 }),
    () => ({ type: "selEnd", t: rnd() * 100e9 }),
    () => ({ type: "zoomSel" }),
    () => ({ type: "zoomAll" }),
    () => ({ type: "shiftSel", dir: rnd() < 0.5 ? 1 : -1 }),
    () => ({ type: "playView" }),
    () => ({ type: "tick", elapsed: rnd() * 20e9 }),
    () => ({ type: "stop" }),
    () => ({ type: "live", on: rnd() < 0.5 }),
    () => ({ type: "nudge", by: (rnd() - 0.5) * 1e9 }),
    () => ({ type: "goto", t: rnd() * 200e9 }),
    () => ({ type: "nonsense" }),
  ];
  const store = createStore(s0);
  for (let i = 0; i < 20000; i++) {
    const s = store.dispatch(acts[Math.floor(rnd() * acts.length)]());
    assert.ok(s.view[1] > s.view[0], "view is not empty");
    assert.ok(Number.isFinite(s.cursor));
    if (s.sel[0] != null && s.sel[1] != null) assert.ok(s.sel[0] <= s.sel[1]);
  }
});

test("a single message is in the middle of the view, under the cursor, and is the end of the data", () => {
  const s = initial(0, 0);
  assert.deepEqual(s.view, [-0.5e9, 0.5e9]);
  assert.deepEqual([s.cursor, s.messages], [0, [0, 0]]);
  const grown = run(s, { type: "data", from: 0, to: 3e9 });
  assert.deepEqual(grown.data, [0, 3e9]);
  assert.deepEqual(grown.messages, [0, 3e9]);
});
