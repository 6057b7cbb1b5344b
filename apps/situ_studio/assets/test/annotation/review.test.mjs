// The order of proposals in a review, its progress, and the view around a proposal.
import assert from "node:assert/strict";
import test from "node:test";
import { listProposals, neighborProposal, progressText, viewAround } from "../../js/annotation/review.js";

const item = (id, from, to, track = "A", proposed = true) => ({ id, from, to, track, proposed });
const items = [item(1, 20, 30), item(2, 0, 10), item(3, 0, 10, "B"), item(4, 5, 8, "A", false)];

test("proposals are reviewed in the order of their times, and accepted annotations are left out", () => {
  assert.deepEqual(
    listProposals(items).map((a) => a.id),
    [2, 3, 1],
  );
});

test("the next proposal follows the current one, also after it was settled; after the last comes the first", () => {
  assert.equal(neighborProposal(items, items[1], 1).id, 3);
  assert.equal(neighborProposal(items, items[0], 1).id, 2);
  assert.equal(neighborProposal(items, items[1], -1).id, 1);
  const settled = { ...items[1], proposed: false };
  assert.equal(neighborProposal([items[0], settled, items[2]], settled, 1).id, 3);
  assert.equal(neighborProposal([items[0]], items[0], 1), null);
  assert.equal(neighborProposal(items, null, 1).id, 2);
});

test("the progress is a sentence, and empty without proposals", () => {
  const review = { total: 40, reviewed: 12, accepted: 9, corrected: 0 };
  assert.equal(progressText(review), "12 of 40 reviewed, 9 accepted");
  assert.equal(progressText({ ...review, corrected: 2 }), "12 of 40 reviewed, 9 accepted, 2 of them corrected");
  assert.equal(progressText({ total: 0, reviewed: 0, accepted: 0, corrected: 0 }), "");
  assert.equal(progressText(undefined), "");
});

test("the view stays if it shows the proposal well, and otherwise moves to it", () => {
  const view = [0, 10e9];
  assert.equal(viewAround({ from: 1e9, to: 2e9 }, view), view);
  assert.deepEqual(viewAround({ from: 11e9, to: 12e9 }, view), [9.5e9, 13.5e9]);
  assert.deepEqual(viewAround({ from: 20e9, to: 30e9 }, view), [15e9, 35e9]);
});
