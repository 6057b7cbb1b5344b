import { test } from "node:test";
import assert from "node:assert/strict";
import { sentence } from "../../js/page/alternative.js";

test("a canvas is told by its streams and times", () => {
  const state = { view: [0, 60e9], cursor: 5.5e9 };
  assert.equal(sentence("plot", ["A", "B.c"], state, true), "Plot of A, B.c from 0:00.000 to 1:00.000");
  assert.equal(sentence("image", ["Camera"], state, false), "Picture of Camera at 0:05.500");
  assert.equal(sentence("unheard-of", [], state, false), "Panel of nothing at 0:05.500");
});
