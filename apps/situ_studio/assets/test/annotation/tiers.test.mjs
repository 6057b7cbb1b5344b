// The rows of tiers, the tracks of keys, transcription rows, and segmentation by one key.
import test from "node:test";
import assert from "node:assert/strict";
import { listTranscriptRows, orderTracks, trackFor } from "../../js/annotation/tiers.js";
import { markBoundary } from "../../js/annotation/segmentation.js";

const tier = (track, attribute, parent = null, relation = null) => ({ track, attribute, parent, relation, depth: 0 });
const tiers = [
  tier("Utt@Ada", "Kind"),
  tier("Words@Ada", "Text", "Utt@Ada", "included_in"),
  tier("Translation@Ada", "Text", "Utt@Ada", "symbolic_association"),
];
const attributes = [
  { name: "Kind", kind: "finite", values: [] },
  { name: "Text", kind: "text", values: [] },
];
const item = (id, track, from, to, values) => ({ id, track, from, to, values });
const items = [
  item("2", "Utt@Ada", 20, 30, { Kind: "a" }),
  item("1", "Utt@Ada", 0, 10, { Kind: "a" }),
  item("3", "Translation@Ada", 20, 30, { Text: "yes" }),
];

test("children follow their parents, and other tracks are sorted", () => {
  assert.deepEqual(orderTracks(["B", "A"], tiers), ["A", "B", "Utt@Ada", "Words@Ada", "Translation@Ada"]);
});

test("tiers without a parent have the order of the schema", () => {
  assert.deepEqual(orderTracks(["A", "B", "C"], [tier("C", "Text"), tier("B", "Text")]), ["A", "C", "B"]);
});

test("a value goes to the tier that has its attribute", () => {
  assert.equal(trackFor(tiers, "Words@Ada", "Kind"), "Utt@Ada");
  assert.equal(trackFor(tiers, "Utt@Ada", "Text"), "Words@Ada");
  assert.equal(trackFor(tiers, "Utt@Ada", undefined), "Utt@Ada");
  assert.equal(trackFor(tiers, "1", "Kind"), "1");
});

test("an associated tier has a row for each annotation of its parent", () => {
  const rows = listTranscriptRows({ tiers, items, attributes }, "Utt@Ada");
  assert.deepEqual(
    rows.map((r) => [r.item?.id ?? null, r.from, r.text, r.track]),
    [
      [null, 0, "", "Translation@Ada"],
      ["3", 20, "yes", "Translation@Ada"],
    ],
  );
  assert.deepEqual(listTranscriptRows({ tiers: [], items, attributes: [attributes[0]] }, "1"), []);
});

test("boundaries make pairs, or a chain without gaps", () => {
  let marks = { mode: "chain", from: null };
  const made = [];
  for (const t of [5, 9, 9, 12]) {
    const [next, segment] = markBoundary(marks, t);
    marks = next;
    if (segment) made.push([segment.from, segment.to]);
  }
  assert.deepEqual(made, [
    [5, 9],
    [9, 12],
  ]);
  assert.deepEqual(markBoundary({ mode: "pairs", from: 7 }, 4), [
    { mode: "pairs", from: null },
    { from: 4, to: 7 },
  ]);
});
