import { test } from "node:test";
import assert from "node:assert/strict";
import {
  COLORS,
  depthStyle,
  depthRange,
  paintDepth,
  paintGray,
  formatDistance,
} from "../../js/visualizers/depth_colors.js";

function paintValues(values, props) {
  const rgba = new Uint8ClampedArray(4 * values.length);
  const range = paintDepth(Uint16Array.from(values), rgba, depthStyle(props));
  return { range, at: (i) => Array.from(rgba.subarray(4 * i, 4 * i + 4)) };
}

const colorAt = (i) => [...COLORS[i], 255];

test("by default the colors cover an image's own readings, and missing readings are transparent", () => {
  const p = paintValues([0, 500, 1500], {});
  assert.deepEqual(p.range, [500, 1500]);
  assert.deepEqual([p.at(0), p.at(1), p.at(2)], [[0, 0, 0, 0], colorAt(0), colorAt(255)]);
});

test("a fixed range gives a distance the same color in every image", () => {
  const fixed = { range: "fixed", min: 400, max: 1400 };
  assert.deepEqual(paintValues([900, 1000], fixed).at(0), paintValues([900, 60000], fixed).at(0));
  assert.deepEqual(paintValues([10, 65535], fixed).at(0), colorAt(0), "nearer than the range: its near end");
  assert.deepEqual(paintValues([10, 65535], fixed).at(1), colorAt(255), "farther: its far end");
});

test("the ends of a range are ordered, and a range is never empty", () => {
  assert.deepEqual(depthStyle({ range: "fixed", min: 1400, max: 400 }).range, [400, 1400]);
  assert.deepEqual(depthStyle({ range: "fixed", min: 7, max: 7 }).range, [7, 8]);
  assert.deepEqual(depthStyle({ range: "fixed" }).range, [0, 65535]);
});

test("sensor modes have their measuring ranges, and unknown modes have none", () => {
  assert.deepEqual(
    ["all", "nfov_binned", "nfov", "wfov_binned", "wfov", "of my own"].map((r) => depthStyle({ range: r }).range),
    [[0, 65535], [500, 5460], [500, 3860], [250, 2880], [250, 2210], null],
  );
});

test("the value for missing readings and its color can be chosen", () => {
  const p = paintValues([65535, 100, 0], { invalid: 65535, invalid_color: "#ff8000" });
  assert.deepEqual(p.at(0), [255, 128, 0, 255]);
  assert.deepEqual(p.range, [0, 100]);
  const every = paintValues([0, 100], { invalid: -1 });
  assert.deepEqual([every.range, every.at(0)], [[0, 100], colorAt(0)], "-1: every value is a reading");
});

test("an image with one value or none has a range", () => {
  assert.deepEqual(depthRange(Uint16Array.of(5, 5)), [5, 6]);
  assert.deepEqual(depthRange(Uint16Array.of(0, 0)), [0, 1]);
  assert.deepEqual(paintValues([0, 0], {}).at(1), [0, 0, 0, 0]);
});

test("16-bit images without depth are gray from the darkest to the brightest value", () => {
  const rgba = new Uint8ClampedArray(12);
  paintGray(Uint16Array.of(1000, 2000, 3000), rgba);
  assert.deepEqual([rgba[0], rgba[4], rgba[8], rgba[3]], [0, 128, 255, 255]);
});

test("a distance is shown in mm or m if the unit is known", () => {
  assert.deepEqual(
    [formatDistance(850, 1000), formatDistance(1234, 1000), formatDistance(65535, 10000), formatDistance(42, 0)],
    ["850 mm", "1.23 m", "655.4 m", "42"],
  );
});
