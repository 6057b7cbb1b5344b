import { test } from "node:test";
import assert from "node:assert/strict";
import { sideOf } from "../../js/page/drag.js";

const box = { left: 100, top: 50, width: 200, height: 100 };

test("a timeline goes above or below what it is dropped on", () => {
  assert.equal(sideOf(box, 150, 60, false), "above");
  assert.equal(sideOf(box, 290, 120, false), "below");
});

test("a cell goes to the nearer side of another, and out of the row at its upper and lower edge", () => {
  assert.equal(sideOf(box, 120, 100, true), "left");
  assert.equal(sideOf(box, 290, 100, true), "right");
  assert.equal(sideOf(box, 120, 55, true), "above");
  assert.equal(sideOf(box, 290, 145, true), "below");
});
