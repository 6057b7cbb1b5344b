// Addresses that keep the view, in the same recording and in another session.
import assert from "node:assert/strict";
import test from "node:test";
import { decodeLink, encodeLink, encodeSession } from "../../js/time/link.js";

const state = { data: [0, 60e9], view: [2e9, 30e9], cursor: 20e9, sel: [null, null], mode: "manual", follow: false };

test("an address of another session has times since the start", () => {
  const query = encodeSession(state, { layout: "Mine", annotate: "Speech", source: "study.json/s1" });
  const found = Object.fromEntries(new URLSearchParams(query));
  assert.deepEqual(found, {
    layout: "Mine",
    annotate: "Speech",
    previous: "study.json/s1",
    since: "20000000000~2000000000~30000000000",
  });
  const { cursor, view } = decodeLink(`?${query}`, 5_000_000_000_000n);
  assert.deepEqual([cursor, view], [20e9, [2e9, 30e9]]);
});

test("a view of all data becomes a view of all data of the other session", () => {
  const query = encodeSession({ ...state, view: [0, 60e9] }, {});
  const { cursor, view } = decodeLink(`?${query}`, 0n);
  assert.deepEqual([cursor, view], [20e9, undefined]);
});

test("absolute times take precedence, and invalid times are ignored", () => {
  const query = encodeLink(state, 1000n);
  assert.equal(decodeLink(`?since=5&${query}`, 1000n).cursor, 20e9);
  assert.equal(decodeLink("?since=x~1~2", 0n).cursor, undefined);
  assert.equal(decodeLink("?since=1~9~3", 0n).view, undefined);
});
