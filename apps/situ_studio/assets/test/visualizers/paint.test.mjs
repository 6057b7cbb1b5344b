import test from "node:test";
import assert from "node:assert/strict";
import { Series } from "../../js/data/series.js";
import { paintLine } from "../../js/visualizers/paint.js";

// Records what is drawn, as text: "M0,1" moves to a point and "L2,3" draws a line to one.
function drawLine(values, step = 10) {
  const series = new Series();
  const columns = { t: Float64Array.from(values, (_, i) => i * step), n: new Float64Array(values.length).fill(1) };
  for (const c of ["min", "max", "last"]) columns[c] = Float64Array.from(values, (v) => v ?? NaN);
  series.putFrame({ ...columns, count: values.length, raw: true }, 0);
  const out = [];
  const ignore = () => {};
  const ctx = {
    beginPath: ignore,
    stroke: ignore,
    fill: ignore,
    arc: ignore,
    moveTo: (x, y) => out.push(`M${x},${y}`),
    lineTo: (x, y) => out.push(`L${x},${y}`),
  };
  const view = [0, values.length * step];
  // a pixel is 20 ns, so that messages have no markers
  paintLine(ctx, series, view, (t) => t / 20, (v) => v, { color: "#fff" }); // prettier-ignore
  return out.join(" ");
}

test("a missing value interrupts a line", () => {
  assert.equal(drawLine([1, 2, null, 3, 4]), "M0,1 L0.5,2 M1.5,3 L2,4");
});

test("a value between two missing ones is a dot, also at the ends", () => {
  assert.equal(drawLine([1, 2, null, 3, null, 4, 5]), "M0,1 L0.5,2 M1.5,3 M0.5,3 L2.5,3 M2.5,4 L3,5");
  assert.equal(drawLine([null, 7, null]), "M0.5,7 M-0.5,7 L1.5,7");
  assert.equal(drawLine([1, 2, null, 3]), "M0,1 L0.5,2 M1.5,3 M0.5,3 L2.5,3");
});
