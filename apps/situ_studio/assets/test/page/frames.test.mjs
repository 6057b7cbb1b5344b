import test from "node:test";
import assert from "node:assert/strict";
import { Frames } from "../../js/page/frames.js";

test("draws the other views if one fails, and reports its error", () => {
  const frames = [];
  const errors = [];
  globalThis.requestAnimationFrame = (draw) => frames.push(draw);
  globalThis.reportError = (error) => errors.push(error.message);
  const drawn = [];
  const views = new Frames({ get: () => ({}) });
  const fail = () => {
    throw new Error("no position");
  };
  views.addView({ render: fail });
  views.addView({ render: () => drawn.push("second") });
  assert.equal(frames.length, 1);
  frames[0]();
  assert.deepEqual(drawn, ["second"]);
  assert.deepEqual(errors, ["no position"]);
});
