// Positions on the axes of the page of experiments.
import assert from "node:assert/strict";
import test from "node:test";
import { axisPosition } from "../../js/page/experiment.js";

test("a position on an axis is between 0 at its lower end and 1 at its upper end", () => {
  const ends = { top: 30, bottom: 230 };
  assert.deepEqual(
    [230, 30, 80, 500, -20].map((y) => axisPosition(y, ends)),
    [0, 1, 0.75, 0, 1],
  );
});
