// Interpolates boxes and points on images between their key frames. Pure; times are relative to the page's origin.

export const POSITION_FIELDS = { box: ["x", "y", "width", "height"], point: ["x", "y"] };

// Returns the shape that the attributes of an annotation stream describe ("box" or "point"), or null.
export function spatialKind(attributes) {
  const numbers = new Set(attributes.filter((a) => a.kind === "number").map((a) => a.name));
  return (
    Object.keys(POSITION_FIELDS).find((kind) => POSITION_FIELDS[kind].every((name) => numbers.has(name))) ?? null
  );
}

// Returns the key frames of a track ordered by time: [{t, place, id}].
export function listKeyFrames(items, track, kind) {
  return items
    .filter((a) => a.track === track && a.from === a.to)
    .map((a) => ({ t: a.from, id: a.id, place: POSITION_FIELDS[kind].map((name) => Number(a.values[name] ?? 0)) }))
    .sort((a, b) => a.t - b.t);
}

// Returns the position at a time as {place, key: whether this is a key frame}, interpolated linearly. Returns null
// before the first and after the last key frame.
/** @param {{t: number, place: number[]}[]} frames @param {number} t */
export function positionAt(frames, t) {
  /** @type {{t: number, place: number[]} | null} */
  let before = null;
  /** @type {{t: number, place: number[]} | null} */
  let after = null;
  for (const f of frames) {
    if (f.t <= t) before = f;
    else {
      after = f;
      break;
    }
  }
  if (before?.t === t) return { place: before.place, key: true };
  if (!before || !after) return null;
  const k = (t - before.t) / (after.t - before.t);
  return { place: before.place.map((v, i) => v + k * (after.place[i] - v)), key: false };
}

/** @typedef {[number, number]} Point */

// Returns the box between two opposite corners in any order, clipped to the image.
/** @param {Point} a @param {Point} b @param {number} width @param {number} height */
export function boxBetween([x0, y0], [x1, y1], width, height) {
  const clamp = (v, most) => Math.min(Math.max(v, 0), most);
  const [l, r] = [clamp(x0, width), clamp(x1, width)].sort((a, b) => a - b);
  const [t, b] = [clamp(y0, height), clamp(y1, height)].sort((p, q) => p - q);
  return [l, t, r - l, b - t];
}

// Returns the part under (x, y): 0..3 for the corners of a box, "all" for its inside or a point, or null.
export function findGrip(place, [x, y], near) {
  if (place.length === 2) return Math.hypot(x - place[0], y - place[1]) <= near ? "all" : null;
  const [l, t, w, h] = place;
  const corners = [
    [l, t],
    [l + w, t],
    [l + w, t + h],
    [l, t + h],
  ];
  const corner = corners.findIndex(([a, b]) => Math.hypot(x - a, y - b) <= near);
  if (corner >= 0) return corner;
  return x >= l && x <= l + w && y >= t && y <= t + h ? "all" : null;
}

// Returns the position after its part was dragged from one point to another.
export function dragPart(place, part, from, to, width, height) {
  const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
  if (part === "all") return place.map((v, i) => v + (i === 0 ? dx : i === 1 ? dy : 0));
  const [l, t, w, h] = place;
  /** @type {Point[]} */
  const corners = [
    [l + w, t + h],
    [l, t + h],
    [l, t],
    [l + w, t],
  ];
  return boxBetween(corners[part], to, width, height);
}
