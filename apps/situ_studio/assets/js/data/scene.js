// Decodes one message into 3D items (docs: `Situ.Studio.Scene`). Arrays are views of the reply, not copies.
// Non-finite numbers are removed and counted here, so that the drawing code only gets valid points.

import { SCENE_BYTES, readScene } from "./frames.js";

const text = new TextDecoder();

export function decodeScene(buffer, at, bytes) {
  const { bytes: size } = readScene(new DataView(buffer, at, bytes), 0);
  const value = JSON.parse(text.decode(new Uint8Array(buffer, at + SCENE_BYTES, size)));
  const base = at + SCENE_BYTES + ((size + 7) & ~7);
  const problems = [...(value.problems ?? [])];
  const items = [];
  for (const item of value.items) {
    const arrays = {};
    for (const [name, [from, length]] of Object.entries(item.at)) {
      if (base + from + length > at + bytes) throw new Error("a scene is cut short");
      arrays[name] = viewArray(name, buffer, base + from, length);
    }
    const problem = (CHECKS[item.kind] ?? skipCheck)(item, arrays);
    if (problem) problems.push(problem);
    items.push({ ...item, ...arrays });
  }
  return { items, problems };
}

const BYTES = new Set(["color", "confidence", "bytes"]);
const NUMBERS = new Set(["index", "edge"]);

function viewArray(name, buffer, from, length) {
  if (BYTES.has(name)) return new Uint8Array(buffer, from, length);
  if (NUMBERS.has(name)) return new Uint32Array(buffer, from, length >> 2);
  return new Float32Array(buffer, from, length >> 2);
}

const skipCheck = () => null;
const CHECKS = {
  points: (item, a) => dropInvalidRows(item, a, 3, "points"),
  voxels: (item, a) => dropInvalidRows(item, a, 3, "voxels"),
  texts: (item, a) => dropInvalidRows(item, a, 3, "texts"),
  lines: (item, a) => dropInvalidRows(item, a, 6, "lines"),
  boxes: (item, a) => dropInvalidRows(item, a, 16, "boxes", "matrix"),
  quads: (item, a) => dropInvalidRows(item, a, 12, "surfaces", "corner"),
  frusta: (item, a) => dropInvalidRows(item, a, 15, "cameras", "corner"),
  graphs: (item, a) => checkNodes(item, a),
  meshes: (item, a) => checkTriangles(item, a),
};

// Removes rows with non-finite coordinates from all arrays of the item.
function dropInvalidRows(item, arrays, width, what, name = "position") {
  const rows = arrays[name];
  /** @type {number[]} */
  const good = [];
  let bad = false;
  for (let i = 0, n = item.count; i < n; i++) {
    let fine = true;
    for (let k = i * width, end = k + width; k < end; k++) if (!Number.isFinite(rows[k])) fine = false;
    if (!fine) {
      if (!bad) for (let j = 0; j < i; j++) good.push(j);
      bad = true;
    } else if (bad) good.push(i);
  }
  if (!bad) return item.count === 0 && item.kind === "points" ? "an empty cloud" : null;
  const dropped = item.count - good.length;
  for (const [key, array] of Object.entries(arrays)) {
    if (key === "bytes") continue;
    const each = array.length / item.count;
    const kept = new array.constructor(good.length * each);
    good.forEach((from, to) => kept.set(array.subarray(from * each, (from + 1) * each), to * each));
    arrays[key] = kept;
  }
  if (item.names) item.names = good.map((i) => item.names[i]);
  const all = item.count;
  item.count = good.length;
  return `${dropped} of ${all} ${what} are invalid: their coordinates are not numbers`;
}

// Nodes keep their indices, since edges refer to them. Invalid nodes and their edges are not drawn.
function checkNodes(item, arrays) {
  const p = arrays.position;
  const bad = new Set();
  for (let i = 0; i < item.count; i++)
    if (!(Number.isFinite(p[3 * i]) && Number.isFinite(p[3 * i + 1]) && Number.isFinite(p[3 * i + 2]))) bad.add(i);
  const edge = arrays.edge ?? new Uint32Array(0);
  const kept = [];
  for (let i = 0; i + 1 < edge.length; i += 2) {
    const [a, b] = [edge[i], edge[i + 1]];
    if (a < item.count && b < item.count && !bad.has(a) && !bad.has(b)) kept.push(a, b);
  }
  const lost = edge.length / 2 - kept.length / 2;
  arrays.edge = Uint32Array.from(kept);
  item.bad = bad;
  if (bad.size) return `${bad.size} of ${item.count} nodes are invalid: their coordinates are not numbers`;
  return lost ? `${lost} edges refer to missing nodes` : null;
}

function checkTriangles(item, arrays) {
  // the arrays arrived with an earlier message
  if (item.held) return null;
  const vertices = arrays.position.length / 3;
  const { index } = arrays;
  for (let i = 0; i < arrays.position.length; i++)
    if (!Number.isFinite(arrays.position[i]))
      return dropMesh(item, arrays, `vertex ${Math.floor(i / 3)} has invalid coordinates`);
  for (let i = 0; i < index.length; i++)
    if (index[i] >= vertices)
      return dropMesh(item, arrays, `triangle ${Math.floor(i / 3)} refers to vertex ${index[i]} of ${vertices}`);
  return null;
}

function dropMesh(item, arrays, why) {
  item.count = 0;
  arrays.position = new Float32Array(0);
  arrays.index = new Uint32Array(0);
  return `a mesh cannot be drawn: ${why}`;
}
