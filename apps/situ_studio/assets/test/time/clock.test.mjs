import test from "node:test";
import assert from "node:assert/strict";

// the page's storage, which does not exist in tests
const kept = new Map();
globalThis.localStorage = {
  getItem: (k) => kept.get(k) ?? null,
  setItem: (k, v) => kept.set(k, v),
  removeItem: (k) => kept.delete(k),
};
const {
  nextClock,
  parseClock,
  rulerTicks,
  setSelectionStart: setSelected,
  formatClock: shown,
  clockMode,
} = await import("../../js/time/clock.js");
const { splitSessionTime: splitPlace } = await import("../../js/page/dialogs.js");

const origin = 1767225600123456789n;
const selectMode = (mode) => {
  while (clockMode() !== mode) nextClock();
};

test("ruler ticks are at round times, whenever the data begin", () => {
  selectMode("utc");
  const { unit, at } = rulerTicks([0, 300e9], 1000, origin);
  assert.equal(unit, 30e9);
  for (const t of at) assert.equal(Number((origin + BigInt(t)) % 30000000000n), 0);
  assert.equal(shown(at[0], origin, unit), "00:00:30");
  selectMode("start");
  assert.equal(rulerTicks([0, 300e9], 1000, origin).at[0], 0);
});

test("times since the selection are formatted and parsed alike", () => {
  selectMode("selection");
  setSelected(61.5e9);
  assert.equal(shown(60e9, origin), "-0:01.500");
  assert.equal(parseClock("0:10.5", origin), 72e9);
  assert.equal(parseClock("2026-01-01T00:00:01Z", origin), null);
  assert.equal(parseClock("1767225601000000000", origin), null);
  assert.ok(rulerTicks([0, 300e9], 1000, origin).at.includes(61.5e9));
  setSelected(null);
  assert.equal(shown(60e9, origin), "1:00.000");
});

test("long labels have more space between them", () => {
  selectMode("utc");
  const { unit } = rulerTicks([0, 999], 1000, origin);
  assert.equal(unit, 200);
});

test("a session name precedes its time", () => {
  assert.deepEqual(splitPlace("a@b@0:05 "), { session: "a@b", text: "0:05" });
  assert.deepEqual(splitPlace(" 1:23.5"), { session: null, text: "1:23.5" });
});
