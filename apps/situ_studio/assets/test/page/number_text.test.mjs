import test from "node:test";
import assert from "node:assert/strict";
import { axisNumber, tickCount, valueTicks } from "../../js/page/number_text.js";

test("numbers beside an axis are short, however large or small", () => {
  const said = [0, 0.25, 1500, 25e3, 1e18, 1.5e294, 1e-9, -2.5e-7].map(axisNumber);
  assert.deepEqual(said, ["0", "0.25", "1500", "25 k", "1e18", "1.5e294", "1e-9", "-2.5e-7"]);
});

test("an axis has two ticks at least, and few where it is high", () => {
  assert.deepEqual([20, 60, 150, 800].map(tickCount), [2, 2, 5, 14]);
  assert.ok(valueTicks(-1e293, 1.1e294, 4).length >= 2);
});
