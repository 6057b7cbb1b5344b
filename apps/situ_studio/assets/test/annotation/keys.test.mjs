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

test("a key held during playback creates one annotation", () => {
  const k = new KeyState(attributes);
  assert.equal(k.pressKey("1", 100, 0), null);
  assert.deepEqual(k.pendingAnnotations(150), [{ from: 100, to: 150, values: { Speech: "speaks" } }]);
  assert.deepEqual(k.releaseKey("1", 200, 900), { from: 100, to: 200, values: { Speech: "speaks" } });
  assert.deepEqual(k.pendingAnnotations(300), []);
});

test("a tapped key begins an annotation that the next tap ends", () => {
  const k = new KeyState(attributes);
  k.pressKey("2", 100, 0);
  assert.equal(k.releaseKey("2", 101, 40), null);
  assert.deepEqual(k.pressKey("2", 500, 3000), { from: 100, to: 500, values: { Speech: "laughs" } });
  assert.equal(k.releaseKey("2", 500, 3040), null);
});

test("a key held without playback leaves the annotation open", () => {
  const k = new KeyState(attributes);
  k.pressKey("1", 100, 0);
  assert.equal(k.releaseKey("1", 100, 5000), null);
  assert.deepEqual(k.pressKey("1", 50, 6000), { from: 50, to: 100, values: { Speech: "speaks" } });
});

test("two annotations can be open, and cancel closes both", () => {
  const k = new KeyState(attributes);
  k.pressKey("1", 1, 0);
  k.pressKey("2", 2, 0);
  assert.equal(k.pendingAnnotations(3).length, 2);
  assert.ok(k.cancelOpen() && !k.cancelOpen());
  assert.ok(k.has("1") && !k.has("3"));
});
