import test from "node:test";
import assert from "node:assert/strict";
import { KeyState } from "../../js/annotation/keys.js";

const attributes = [
  {
    name: "Speech",
    kind: "finite",
    values: [{ value: "speaks", key: "1" }, { value: "laughs", key: "2" }, { value: "none" }],
  },
];

test("a key that is held while the time goes on makes one annotation", () => {
  const k = new KeyState(attributes);
  assert.equal(k.down("1", 100, 0), null);
  assert.deepEqual(k.pending(150), [{ from: 100, to: 150, values: { Speech: "speaks" } }]);
  assert.deepEqual(k.up("1", 200, 900), { from: 100, to: 200, values: { Speech: "speaks" } });
  assert.deepEqual(k.pending(300), []);
});

test("a key that is tapped begins, and ends at the next tap", () => {
  const k = new KeyState(attributes);
  k.down("2", 100, 0);
  assert.equal(k.up("2", 101, 40), null);
  assert.deepEqual(k.down("2", 500, 3000), { from: 100, to: 500, values: { Speech: "laughs" } });
  assert.equal(k.up("2", 500, 3040), null);
});

test("a key held while the time stands still leaves the annotation open", () => {
  const k = new KeyState(attributes);
  k.down("1", 100, 0);
  assert.equal(k.up("1", 100, 5000), null);
  assert.deepEqual(k.down("1", 50, 6000), { from: 50, to: 100, values: { Speech: "speaks" } });
});

test("two at a time, and none after a cancel", () => {
  const k = new KeyState(attributes);
  k.down("1", 1, 0);
  k.down("2", 2, 0);
  assert.equal(k.pending(3).length, 2);
  assert.ok(k.cancel() && !k.cancel());
  assert.ok(k.has("1") && !k.has("3"));
});
