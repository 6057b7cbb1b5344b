// Scenes as sent by the server, packed by hand in the format of `Situ.Studio.Scene.pack/2`.
import test from "node:test";
import assert from "node:assert/strict";
import { decodeScene } from "../../js/data/scene.js";

// rows: [{kind, count, numbers: {name: typed array}, ...}]
function packScene(rows, problems = []) {
  const blobs = [];
  let at = 0;
  const items = rows.map(({ numbers, ...item }) => {
    const places = {};
    for (const [name, array] of Object.entries(numbers)) {
      const bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
      places[name] = [at, bytes.length];
      blobs.push([at, bytes]);
      at += (bytes.length + 7) & ~7;
    }
    return { ...item, at: places };
  });
  const json = new TextEncoder().encode(JSON.stringify({ items, problems }));
  const head = 8 + ((json.length + 7) & ~7);
  const buffer = new ArrayBuffer(head + at);
  const all = new Uint8Array(buffer);
  new DataView(buffer).setUint32(0, json.length, true);
  all.set(json, 8);
  for (const [from, bytes] of blobs) all.set(bytes, head + from);
  return buffer;
}

const readScene = (rows, problems) => {
  const buffer = packScene(rows, problems);
  return decodeScene(buffer, 0, buffer.byteLength);
};
const cloudItem = (...p) => ({ kind: "points", count: p.length / 3, numbers: { position: Float32Array.from(p) } });

test("arrays are views of the reply, not copies", () => {
  const buffer = packScene([cloudItem(1, 2, 3, 4, 5, 6)]);
  const { items, problems } = decodeScene(buffer, 0, buffer.byteLength);
  assert.deepEqual([...items[0].position], [1, 2, 3, 4, 5, 6]);
  assert.equal(items[0].position.buffer, buffer);
  assert.deepEqual(problems, []);
});

test("invalid points are removed together with their attributes, and reported", () => {
  const item = cloudItem(1, 2, 3, NaN, 0, 0, 7, 8, 9, 0, Infinity, 0);
  item.numbers.color = Uint8Array.from([1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4]);
  item.names = ["a", "b", "c", "d"];
  const { items, problems } = readScene([item], ["said before"]);
  assert.equal(items[0].count, 2);
  assert.deepEqual([...items[0].position], [1, 2, 3, 7, 8, 9]);
  assert.deepEqual([...items[0].color], [1, 1, 1, 3, 3, 3]);
  assert.deepEqual(items[0].names, ["a", "c"]);
  assert.deepEqual(problems, ["said before", "2 of 4 points are invalid: their coordinates are not numbers"]);
});

test("an empty cloud is reported", () => {
  assert.deepEqual(readScene([cloudItem()]).problems, ["an empty cloud"]);
});

test("a mesh whose triangles refer to missing vertices is not drawn", () => {
  const meshItem = (index, position = [0, 0, 0, 1, 0, 0, 0, 1, 0]) => ({
    kind: "meshes",
    count: 1,
    numbers: { position: Float32Array.from(position), index: Uint32Array.from(index) },
  });
  assert.deepEqual(readScene([meshItem([0, 1, 2])]).problems, []);
  const bad = readScene([meshItem([0, 1, 3])]);
  assert.equal(bad.items[0].count, 0);
  assert.match(bad.problems[0], /triangle 0 refers to vertex 3 of 3/);
  assert.match(
    readScene([meshItem([0, 1, 2], [0, 0, 0, 1, NaN, 0, 0, 1, 0])]).problems[0],
    /vertex 1 has invalid coordinates/,
  );
});

test("nodes keep their indices, and edges of invalid nodes are removed", () => {
  const graph = {
    kind: "graphs",
    count: 3,
    numbers: {
      position: Float32Array.from([0, 0, 0, NaN, 0, 0, 2, 0, 0]),
      edge: Uint32Array.from([0, 1, 0, 2, 2, 9]),
    },
  };
  const { items, problems } = readScene([graph]);
  assert.deepEqual([...items[0].edge], [0, 2]);
  assert.ok(items[0].bad.has(1));
  assert.match(problems[0], /1 of 3 nodes are invalid/);
});

test("a truncated scene is rejected", () => {
  const buffer = packScene([cloudItem(1, 2, 3, 4, 5, 6)]);
  assert.throws(() => decodeScene(buffer, 0, buffer.byteLength - 8), /cut short/);
});
