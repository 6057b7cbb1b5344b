import test from "node:test";
import assert from "node:assert/strict";
import { clockText } from "../../js/page/times.js";

test("times in lists are shown in UTC or local time", () => {
  const ns = "1767225600123456789";
  assert.equal(clockText(ns, "all", false), "2026-01-01 00:00:00.123 UTC");
  assert.equal(clockText(ns, "both", false), "2026-01-01 00:00:00 UTC");
  assert.equal(clockText(ns, "date", false), "2026-01-01");
  assert.equal(clockText(ns, "time", false), "00:00:00 UTC");
  const zone = process.env.TZ;
  process.env.TZ = "America/New_York";
  assert.equal(clockText(ns, "both", true), "2025-12-31 19:00:00");
  if (zone === undefined) delete process.env.TZ;
  else process.env.TZ = zone;
});

test("a time before 1971 is not a date and counts from 0", () => {
  assert.equal(clockText("1470000000", "all", false), "0:01.470 from 0");
  assert.equal(clockText("0", "both", true), "0:00.000 from 0");
  assert.equal(clockText("-1000000000", "time", false), "-0:01.000 from 0");
  assert.equal(clockText("5", "date", false), "no date");
});

test("a time beyond all calendar dates is shown as a number", () =>
  assert.equal(clockText("9".repeat(30), "all", false), "9".repeat(30)));
