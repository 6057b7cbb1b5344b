import { test } from "node:test";
import assert from "node:assert/strict";
import { dropSide, rimSide } from "../../js/page/drag.js";

const box = { left: 100, top: 50, width: 200, height: 100, right: 300, bottom: 150 };

test("a panel is placed at the side of the nearest edge, or as a tab in the middle", () => {
  assert.equal(dropSide(box, 120, 100, "tab"), "left");
  assert.equal(dropSide(box, 290, 100, "tab"), "right");
  assert.equal(dropSide(box, 180, 55, "tab"), "above");
  assert.equal(dropSide(box, 190, 145, "tab"), "below");
  assert.equal(dropSide(box, 200, 100, "tab"), "tab");
});

test("a panel is placed at a side of all others at the edge of their area", () => {
  assert.equal(rimSide(box, 103, 90), "left");
  assert.equal(rimSide(box, 298, 90), "right");
  assert.equal(rimSide(box, 200, 52), "above");
  assert.equal(rimSide(box, 200, 145), "below");
  assert.equal(rimSide(box, 200, 100), null);
});
