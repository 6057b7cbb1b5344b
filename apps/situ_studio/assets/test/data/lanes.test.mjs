import test from "node:test";
import assert from "node:assert/strict";
import { keepSegments, laneNames, segmentAt, segmentText, markText } from "../../js/data/lanes.js";
import { Series, keepLines } from "../../js/data/series.js";

const laneRows = (map, name = "") => map.get(name)?.map(([a, b, label]) => [a, b, label]);

test("segments are grouped by lane, with times relative to the origin", () => {
  const held = keepSegments(
    null,
    [
      [0, 5, "true", "true", "b"],
      [5, null, "false", "false", "b"],
      [2, 4, "x", "text", "10"],
      [1, 2, "x", "text", "9"],
    ],
    100,
    0,
  );
  assert.deepEqual(laneNames(held), ["9", "10", "b"]);
  assert.deepEqual(laneRows(held, "b"), [
    [100, 105, "true"],
    [105, Infinity, "false"],
  ]);
  assert.deepEqual(laneNames(null), [""]);
});

test("a state that continues across two windows is one segment", () => {
  const held = keepSegments(
    null,
    [
      [0, 5, "off", "state"],
      [5, null, "on", "state"],
    ],
    0,
    0,
  );
  const next = keepSegments(held, [[8, null, "on", "state"]], 0, 8);
  assert.deepEqual(laneRows(next), [
    [0, 5, "off"],
    [5, Infinity, "on"],
  ]);
  const changed = keepSegments(
    next,
    [
      [9, 12, "on", "state"],
      [12, null, "off", "state"],
    ],
    0,
    9,
  );
  assert.deepEqual(laneRows(changed), [
    [0, 5, "off"],
    [5, 12, "on"],
    [12, Infinity, "off"],
  ]);
});

test("equal texts stay separate, and an open one ends where the next begins", () => {
  const held = keepSegments(null, [[0, null, "hm", "text"]], 0, 0);
  assert.deepEqual(laneRows(keepSegments(held, [[7, null, "hm", "text"]], 0, 7)), [
    [0, 7, "hm"],
    [7, Infinity, "hm"],
  ]);
});

test("a lane that is missing in the new window ends with the old one", () => {
  const held = keepSegments(
    null,
    [
      [0, null, "true", "true", "a"],
      [0, null, "true", "true", "b"],
    ],
    0,
    0,
  );
  const next = keepSegments(held, [[9, null, "true", "true", "b"]], 0, 9);
  assert.deepEqual(laneRows(next, "a"), [[0, 9, "true"]]);
  assert.deepEqual(laneRows(next, "b"), [[0, Infinity, "true"]]);
});

test("an interval that is sent twice is kept once", () => {
  const held = keepSegments(
    null,
    [
      [0, 5, "", "span"],
      [6, 8, "", "span"],
    ],
    0,
    0,
  );
  const next = keepSegments(
    held,
    [
      [6, 8, "", "span"],
      [9, 10, "", "span"],
    ],
    0,
    7,
  );
  assert.deepEqual(laneRows(next), [
    [0, 5, ""],
    [6, 8, ""],
    [9, 10, ""],
  ]);
});

const columnFrame = (t, v) => {
  const toFloats = (xs) => Float64Array.from(xs);
  return {
    count: t.length,
    raw: true,
    t: toFloats(t),
    min: toFloats(v),
    max: toFloats(v),
    last: toFloats(v),
    n: toFloats(t.map(() => 1)),
  };
};

test("lines grow by name, and a line that has ended is removed when it is out of view", () => {
  const held = keepLines(
    new Map(),
    [
      { name: "a", ...columnFrame([0, 1], [1, 2]) },
      { name: "b", ...columnFrame([0], [5]) },
    ],
    0,
    -Infinity,
    -Infinity,
  );
  const next = keepLines(
    held,
    [
      { name: "a", ...columnFrame([1, 2], [2, 3]) },
      { name: "c", ...columnFrame([2], [9]) },
    ],
    0,
    1,
    -5,
  );
  assert.deepEqual([...next.keys()], ["a", "b", "c"]);
  assert.deepEqual([...next.get("a").last.subarray(0, 3)], [1, 2, 3]);
  assert.deepEqual([...keepLines(next, [{ name: "a", ...columnFrame([9], [4]) }], 0, 9, 5).keys()], ["a"]);
});

test("NaN does not affect the extent", () => {
  const s = new Series();
  s.putFrame(columnFrame([0, 1, 2], [1, NaN, 3]), 0);
  assert.deepEqual(s.valueExtent(0, 2), [1, 3]);
});

test("the segment under the mouse is described in full, narrow ones within a few pixels", () => {
  const rows = [
    [0, 4e9, "idle", "state"],
    [4e9, 4e9 + 10, "blip", "state"],
    [10e9, Infinity, "", "true"],
  ];
  assert.deepEqual(segmentText(segmentAt(rows, 2e9, 1e6)), ["idle", "0:00.000 to 0:04.000, 4.00 s"]);
  assert.equal(segmentAt(rows, 4e9 + 5e5, 1e6)[2], "blip");
  assert.equal(segmentAt(rows, 7e9, 1e6), null);
  assert.deepEqual(segmentText(segmentAt(rows, 60e9, 1e6)), ["true", "since 0:10.000"]);
  assert.deepEqual(segmentText([0, 5e8, "", "span"]), ["0:00.000 to 0:00.500, 500 ms"]);
});

test("of overlapping intervals, the one that began last is described", () => {
  const rows = [
    [0, 10e9, "long", "span"],
    [2e9, 3e9, "short", "span"],
  ];
  assert.equal(segmentAt(rows, 2.5e9, 0)[2], "short");
  assert.equal(segmentAt(rows, 5e9, 0)[2], "long");
});

test("the message nearest to the mouse is described with its latency", () => {
  const marks = { t: [1e9, 2e9], latency: [3e6, 80e6] };
  assert.deepEqual(markText(marks, 1.9e9, 2e8), ["message at 0:02.000", "latency 80.0 ms"]);
  assert.deepEqual(markText(marks, 1.5e9, 1e8), []);
  assert.deepEqual(markText({ t: [], latency: [] }, 0, 1e9), []);
});
