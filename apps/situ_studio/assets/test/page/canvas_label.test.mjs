import { test } from "node:test";
import assert from "node:assert/strict";
import { describePanel } from "../../js/page/canvas_label.js";

test("a canvas is described by its streams and times", () => {
  const state = { view: [0, 60e9], cursor: 5.5e9 };
  assert.equal(describePanel("plot", ["A", "B.c"], state, true), "Plot of A, B.c from 0:00.000 to 1:00.000");
  assert.equal(describePanel("image", ["Camera"], state, false), "Image of Camera at 0:05.500");
  assert.equal(describePanel("unheard-of", [], state, false), "Panel of nothing at 0:05.500");
});
