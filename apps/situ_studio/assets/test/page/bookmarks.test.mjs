import { test } from "node:test";
import assert from "node:assert/strict";
import { neighbour, splitList } from "../../js/page/bookmarks.js";

test("the neighbour of a time is the next or the previous bookmark, never the one at this time", () => {
  const sorted = [{ from: 10 }, { from: 20 }, { from: 30 }];
  assert.equal(neighbour(sorted, 20, 1)?.from, 30);
  assert.equal(neighbour(sorted, 20, -1)?.from, 10);
  assert.equal(neighbour(sorted, 12, 1)?.from, 20);
  assert.equal(neighbour(sorted, 30, 1), null);
  assert.equal(neighbour([], 0, -1), null);
});

test("a comment may end with the name of its list", () => {
  assert.deepEqual(splitList("wheel is stuck #repairs"), { text: "wheel is stuck", list: "repairs" });
  assert.deepEqual(splitList("  no list "), { text: "no list", list: "" });
  assert.deepEqual(splitList("#best moments"), { text: "", list: "best moments" });
  assert.deepEqual(splitList("C#"), { text: "C#", list: "" });
});
