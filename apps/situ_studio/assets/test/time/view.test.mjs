import test from "node:test";
import assert from "node:assert/strict";
import { reduce, initialState, createStore, rangeWidth } from "../../js/time/view.js";

const s0 = initialState(0, 100e9);
const runActions = (s, ...actions) => actions.reduce(reduce, s);

test("zooming about a time keeps its position in the view", () => {
  const s = runActions(s0, { type: "zoomAt", t: 25e9, factor: 0.5 });
  assert.deepEqual(s.view, [12.5e9, 62.5e9]);
  assert.equal((25e9 - s.view[0]) / rangeWidth(s.view), 0.25);
});

test("some data always stay in the view", () => {
  const s = runActions(s0, { type: "pan", by: 1e15 });
  assert.ok(s.view[0] < s.data[1]);
  const z = runActions(s0, { type: "zoom", factor: 1e6 });
  assert.equal(rangeWidth(z.view), 1000e9);
});

test("a selection end before its start opens the other end", () => {
  const s = runActions(s0, { type: "selStart", t: 10e9 }, { type: "selEnd", t: 5e9 });
  assert.deepEqual(s.sel, [null, 5e9]);
  const z = runActions(s0, { type: "selStart", t: 10e9 }, { type: "selEnd", t: 30e9 }, { type: "zoomSel" });
  assert.deepEqual(z.view, [9e9, 31e9]);
});

test("a shifted selection stays within the data and in view", () => {
  const a = runActions(
    s0,
    { type: "select", from: 10e9, to: 30e9 },
    { type: "zoomSel" },
    { type: "shiftSel", dir: 1 },
  );
  assert.deepEqual(a.sel, [30e9, 50e9]);
  assert.ok(a.view[0] <= 30e9 && a.view[1] >= 50e9);
  const b = runActions(a, { type: "shiftSel", dir: 9 });
  assert.deepEqual(b.sel, [80e9, 100e9]);
});

test("playback runs at its speed, and stops or repeats at the end", () => {
  let s = runActions(s0, { type: "speed", value: 4 }, { type: "play", from: 90e9, to: 100e9 });
  s = runActions(s, { type: "tick", elapsed: 1e9 });
  assert.equal(s.cursor, 94e9);
  const stopped = runActions(s, { type: "tick", elapsed: 9e9 });
  assert.equal(stopped.mode, "manual");
  assert.equal(stopped.cursor, 100e9);
  const again = runActions(s, { type: "repeat" }, { type: "tick", elapsed: 9e9 });
  assert.equal(again.mode, "play");
  assert.equal(again.cursor, 90e9);
});

test("live follows the newest time with the cursor at 80 % of a 30 s view", () => {
  let s = runActions(s0, { type: "live", on: true }, { type: "data", from: 0, to: 200e9 });
  assert.deepEqual(s.view, [176e9, 206e9]);
  assert.equal(s.cursor, 200e9);
  s = runActions(s, { type: "zoomAt", t: 0, factor: 0.5 });
  assert.equal(rangeWidth(s.view), 15e9);
  s = runActions(s, { type: "live", on: false }, { type: "data", from: 0, to: 300e9 });
  assert.equal(s.cursor, 200e9);
});

test("the mouse moves the cursor only in manual mode and while following", () => {
  assert.equal(runActions(s0, { type: "move", t: 5 }).cursor, 5);
  assert.equal(runActions(s0, { type: "follow" }, { type: "move", t: 5 }).cursor, 0);
  assert.equal(runActions(s0, { type: "play", from: 0, to: 9 }, { type: "move", t: 5 }).cursor, 0);
});

test("go to time centres the view within the data and holds the cursor", () => {
  const s = runActions(s0, { type: "view", from: 0, to: 10e9 }, { type: "goto", t: 50e9 });
  assert.deepEqual(s.view, [45e9, 55e9]);
  assert.equal(runActions(s, { type: "move", t: 5 }).cursor, 50e9);
});

test("random actions keep the invariants", () => {
  let seed = 7;
  const randomNumber = () => (seed = (seed * 1103515245 + 12345) % 2147483648) / 2147483648;
  const acts = [
    () => ({ type: "zoomAt", t: randomNumber() * 100e9, factor: 0.2 + 2 * randomNumber() }),
    () => ({ type: "pan", by: (randomNumber() - 0.5) * 300e9 }),
    () => ({ type: "selStart", t: randomNumber() * 100e9 }),
    () => ({ type: "selEnd", t: randomNumber() * 100e9 }),
    () => ({ type: "zoomSel" }),
    () => ({ type: "zoomAll" }),
    () => ({ type: "shiftSel", dir: randomNumber() < 0.5 ? 1 : -1 }),
    () => ({ type: "playView" }),
    () => ({ type: "tick", elapsed: randomNumber() * 20e9 }),
    () => ({ type: "stop" }),
    () => ({ type: "live", on: randomNumber() < 0.5 }),
    () => ({ type: "nudge", by: (randomNumber() - 0.5) * 1e9 }),
    () => ({ type: "goto", t: randomNumber() * 200e9 }),
    () => ({ type: "nonsense" }),
  ];
  const store = createStore(s0);
  for (let i = 0; i < 20000; i++) {
    const s = store.dispatch(acts[Math.floor(randomNumber() * acts.length)]());
    assert.ok(s.view[1] > s.view[0], "the view is not empty");
    assert.ok(Number.isFinite(s.cursor));
    if (s.sel[0] != null && s.sel[1] != null) assert.ok(s.sel[0] <= s.sel[1]);
  }
});

test("a single message is in the middle of the view, under the cursor, and is the end of the data", () => {
  const s = initialState(0, 0);
  assert.deepEqual(s.view, [-0.5e9, 0.5e9]);
  assert.deepEqual([s.cursor, s.messages], [0, [0, 0]]);
  const grown = runActions(s, { type: "data", from: 0, to: 3e9 });
  assert.deepEqual(grown.data, [0, 3e9]);
  assert.deepEqual(grown.messages, [0, 3e9]);
});
