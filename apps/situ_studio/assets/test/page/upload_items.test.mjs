import test from "node:test";
import assert from "node:assert/strict";
import { chosenItems, droppedItems } from "../../js/page/upload_items.js";

const paths = (items) => items.map(({ name, files }) => [name, files.map(({ path }) => path)]);
const file = (name, path = "") => Object.assign(new File(["x"], name), { webkitRelativePath: path });

test("chosen files are items, and the files of a folder are one item", () => {
  const chosen = [file("walk.csv"), file("a", "Talk/a"), file("b", "Talk/deep/b"), file("film.mp4")];
  assert.deepEqual(paths(chosenItems(chosen)), [
    ["walk.csv", ["walk.csv"]],
    ["Talk", ["Talk/a", "Talk/deep/b"]],
    ["film.mp4", ["film.mp4"]],
  ]);
  assert.deepEqual(chosenItems([]), []);
});

// An entry as browsers give it: a folder returns its children in parts.
const entry = (name, children) =>
  children
    ? {
        name,
        isFile: false,
        createReader() {
          const left = [...children];
          return { readEntries: (done) => done(left.splice(0, 2)) };
        },
      }
    : { name, isFile: true, file: (done) => done(file(name)) };

test("dropped folders are read completely, and files without an entry are kept", async () => {
  const folder = entry("Talk", [entry("a"), entry("b"), entry("deep", [entry("c")]), entry("d"), entry("e")]);
  const items = [
    { webkitGetAsEntry: () => folder, getAsFile: () => null },
    { webkitGetAsEntry: () => null, getAsFile: () => file("walk.csv") },
    { webkitGetAsEntry: () => null, getAsFile: () => null },
  ];
  const dropped = await droppedItems(/** @type {any} */ ({ items }));
  assert.deepEqual(paths(dropped), [
    ["Talk", ["Talk/a", "Talk/b", "Talk/deep/c", "Talk/d", "Talk/e"]],
    ["walk.csv", ["walk.csv"]],
  ]);
});
