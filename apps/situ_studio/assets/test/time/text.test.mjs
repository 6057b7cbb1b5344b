import test from "node:test";
import assert from "node:assert/strict";
import {
  formatRelative,
  formatDuration,
  formatLatency,
  formatAbsolute,
  parseTime,
  timeTicks,
  formatIso,
} from "../../js/time/text.js";

test("relative times are formatted", () => {
  assert.equal(formatRelative(83.25e9), "1:23.250");
  assert.equal(formatRelative(-1.5e9), "-0:01.500");
  assert.equal(formatRelative(3725e9, 1e9), "1:02:05");
  assert.equal(formatRelative(0.9999999e9, 1e9), "0:01");
  assert.equal(formatRelative(26 * 3600e9, 3600e9), "1d 2:00:00");
  assert.equal(formatRelative(14 * 86400e9, 7 * 86400e9), "14d");
  assert.equal(formatRelative(500, 100), "0:00.000000500");
});

test("durations are formatted", () => {
  assert.equal(formatDuration(1234567), "1.23 ms");
  assert.equal(formatDuration(95e9), "1 min 35 s");
  assert.equal(formatDuration(61.94e9), "1 min 01.9 s");
  assert.equal(formatDuration(119.97e9), "2 min 00 s");
  assert.equal(formatDuration(26 * 3600e9), "26 h 00 min");
  assert.equal(formatDuration(8759 * 3600e9), "364 d 23 h");
});

test("absolute times keep tenths of milliseconds", () => {
  assert.equal(formatAbsolute(1.5e9, 0n), "1970-01-01 00:00:01.5000");
  assert.equal(formatAbsolute(0, 1767225600123456789n), "2026-01-01 00:00:00.1234");
});

test("go to time accepts clock, seconds, units, ISO and nanoseconds", () => {
  const o = 1767225600000000000n;
  assert.equal(parseTime("1:23.5", o), 83.5e9);
  assert.equal(parseTime("83.5", o), 83.5e9);
  assert.equal(parseTime("250 ms", o), 250e6);
  for (const t of [26 * 3600e9, 400 * 86400e9 + 1e9]) assert.equal(parseTime(formatRelative(t), o), t);
  assert.equal(parseTime("-2d 1:00", o), -(2 * 86400e9 + 60e9));
  assert.equal(parseTime("14d", o), 14 * 86400e9);
  assert.equal(parseTime("2026-01-01T00:00:01.25Z", o), 1.25e9);
  assert.equal(parseTime("1767225601000000000", o), 1e9);
  assert.equal(parseTime("yesterday", o), null);
  assert.equal(parseTime("2026-99-99T00:00:00Z", o), null);
});

test("ruler ticks are multiples of one readable unit", () => {
  const { unit, at } = timeTicks([0, 60e9], 1200, 80);
  assert.equal(unit, 5e9);
  assert.equal(at.length, 13);
  assert.equal(timeTicks([0, 999], 1000, 80).unit, 100);
});

test("a copied time is parsed to the exact nanosecond", () => {
  for (const [t, origin] of [
    [27_719_200_001, 1767225600000000000n],
    [5, 0n],
    [-1, 0n],
    [1_500_000_000, -10_000_000_000n],
  ]) {
    assert.equal(parseTime(formatIso(t, origin), origin), t);
  }
  assert.equal(formatIso(1, 0n), "1970-01-01T00:00:00.000000001Z");
});

test("an impossible latency is shown as text", () => {
  assert.deepEqual([2e6, -5e6, -1.47e9, 1.7e18].map(formatLatency), [
    "2.00 ms",
    "-5.00 ms",
    "not real time",
    "not real time",
  ]);
});
