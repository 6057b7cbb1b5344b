// The order of disagreements, and the text of the toolbar.
import test from "node:test";
import assert from "node:assert/strict";
import { agreementText, nextDisagreement } from "../../js/annotation/merged.js";

const segment = (from, agree) => ({ track: "1", from, to: from + 5, agree });
const segments = [segment(20, false), segment(5, true), segment(0, false)];

test("disagreements are visited in the order of time", () => {
  assert.equal(nextDisagreement(segments, 0, 1)?.from, 20);
  assert.equal(nextDisagreement(segments, 20, -1)?.from, 0);
  assert.equal(nextDisagreement(segments, 20, 1), null);
});

test("the toolbar names the kappa of each layer", () => {
  const layers = [
    { stream: "S.Ada", kappa: 0.876 },
    { stream: "S.Ben", kappa: null },
  ];
  assert.equal(agreementText({ layers, segments }), "S.Ada: κ 0.88, S.Ben: κ undefined; 2 disagreements");
});
