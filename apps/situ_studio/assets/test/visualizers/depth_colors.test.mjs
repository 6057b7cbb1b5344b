import { test } from "node:test";
import assert from "node:assert/strict";
import { COLORS, look, depthRange, paintDepth, paintGray, distance } from "../../js/visualizers/depth_colors.js";

function painted(values, props) {
  const rgba = new Uint8ClampedArray(4 * values.length);
  const range = paintDepth(Uint16Array.from(values), rgba, look(props));
  return { range, at: (i) => Array.from(rgba.subarray(4 * i, 4 * i + 4)) };
}

const color = (i) => [...COLORS[i], 255];

test("by itself a picture's colours span its own readings, and no reading is see-through", () => {
  const p = painted([0, 500, 1500], {});
  assert.deepEqual(p.range, [500, 1500]);
  assert.deepEqual([p.at(0), p.at(1), p.at(2)], [[0, 0, 0, 0], color(0), color(255)]);
});

test("a fixed range gives the same colour to the same distance in every picture", () => {
  const fixed = { range: "fixed", min: 400, max: 1400 };
  assert.deepEqual(painted([900, 1000], fixed).at(0), painted([900, 60000], fixed).at(0));
  assert.deepEqual(painted([10, 65535], fixed).at(0), color(0), "nearer than the range: its near end");
  assert.deepEqual(painted([10, 65535], fixed).at(1), color(255), "farther: its far end");
});

test("ends in the wrong order are put right, and a range is never empty", () => {
  assert.deepEqual(look({ range: "fixed", min: 1400, max: 400 }).range, [400, 1400]);
  assert.deepEqual(look({ range: "fixed", min: 7, max: 7 }).range, [7, 8]);
  assert.deepEqual(look({ range: "fixed" }).range, [0, 65535]);
});

test("sensors' modes have the ranges they can measure; an unknown one is as none", () => {
  assert.deepEqual(
    ["all", "nfov_binned", "nfov", "wfov_binned", "wfov", "of my own"].map((r) => look({ range: r }).range),
    [[0, 65535], [500, 5460], [500, 3860], [250, 2880], [250, 2210], null],
  );
});

test("the value that is no reading is chosen, and drawn in a colour", () => {
  const p = painted([65535, 100, 0], { invalid: 65535, invalid_color: "#ff8000" });
  assert.deepEqual(p.at(0), [255, 128, 0, 255]);
  assert.deepEqual(p.range, [0, 100]);
  const every = painted([0, 100], { invalid: -1 });
  assert.deepEqual([every.range, every.at(0)], [[0, 100], color(0)], "-1: every value is a reading");
});

test("a picture of one value, or of none, has a range all the same", () => {
  assert.deepEqual(depthRange(Uint16Array.of(5, 5)), [5, 6]);
  assert.deepEqual(depthRange(Uint16Array.of(0, 0)), [0, 1]);
  assert.deepEqual(painted([0, 0], {}).at(1), [0, 0, 0, 0]);
});

test("16 bits that are no depth are grey from the darkest to the brightest", () => {
  const rgba = new Uint8ClampedArray(12);
  paintGray(Uint16Array.of(1000, 2000, 3000), rgba);
  assert.deepEqual([rgba[0], rgba[4], rgba[8], rgba[3]], [0, 128, 255, 255]);
});

test("a distance is told in mm or m where the unit is known", () => {
  assert.deepEqual(
    [distance(850, 1000), distance(1234, 1000), distance(65535, 10000), distance(42, 0)],
    ["850 mm", "1.23 m", "655.4 m", "42"],
  );
});
