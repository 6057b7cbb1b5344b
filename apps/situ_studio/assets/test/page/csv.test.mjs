import test from "node:test";
import assert from "node:assert/strict";
import { csvLine } from "../../js/page/csv.js";

test("cells with commas, quotes and line breaks are quoted", () => {
  assert.equal(csvLine(["Level", "12", "0.5"]), "Level,12,0.5\r\n");
  assert.equal(csvLine(['say "go", now', "a\nb", ""]), '"say ""go"", now","a\nb",\r\n');
});
