import { test } from "node:test";
import assert from "node:assert/strict";
import { dropSide } from "../../js/page/drag.js";

const box = { left: 100, top: 50, width: 200, height: 100 };

test("a timeline is placed above or below its drop target", () => {
  assert.equal(dropSide(box, 150, 60, false), "above");
  assert.equal(dropSide(box, 290, 120, false), "below");
});

test("a cell is placed on the nearer side of another, and outside of the row near its upper and lower edges", () => {
  assert.equal(dropSide(box, 120, 100, true), "left");
  assert.equal(dropSide(box, 290, 100, true), "right");
  assert.equal(dropSide(box, 120, 55, true), "above");
  assert.equal(dropSide(box, 290, 145, true), "below");
});
