// Boxes and points on pictures: where they are between their key frames. Pure; times are those of the page.

export const PLACES = { box: ["x", "y", "width", "height"], point: ["x", "y"] };

// Which of both the attributes of a stream of annotations say, or null.
export function spatialKind(attributes) {
  const numbers = new Set(attributes.filter((a) => a.kind === "number").map((a) => a.name));
  return Object.keys(PLACES).find((kind) => PLACES[kind].every((name) => numbers.has(name))) ?? null;
}

// The key frames of a track in the order of time: [{t, place, id}].
export function keyFrames(items, track, kind) {
  return items
    .filter((a) => a.track === track && a.from === a.to)
    .map((a) => ({ t: a.from, id: a.id, place: PLACES[kind].map((name) => Number(a.values[name] ?? 0)) }))
    .sort((a, b) => a.t - b.t);
}

// Where it is at a time: {place, key: whether that is a key frame}, on the line between two; null before the first and
// after the last.
export function placeAt(frames, t) {
  let before = null,
    after = null;
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

// A box that was drawn from one corner to the other, whichever way, within the picture.
export function boxOf([x0, y0], [x1, y1], width, height) {
  const clip = (v, most) => Math.min(Math.max(v, 0), most);
  const [l, r] = [clip(x0, width), clip(x1, width)].sort((a, b) => a - b);
  const [t, b] = [clip(y0, height), clip(y1, height)].sort((p, q) => p - q);
  return [l, t, r - l, b - t];
}

// Which part of a place is under (x, y): 0..3 are the corners of a box, "all" the rest of it or a point.
export function grip(place, [x, y], near) {
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

// The place after its part was dragged from one point to another.
export function dragged(place, part, from, to, width, height) {
  const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
  if (part === "all") return place.map((v, i) => v + (i === 0 ? dx : i === 1 ? dy : 0));
  const [l, t, w, h] = place;
  const fixed = [
    [l + w, t + h],
    [l, t + h],
    [l, t],
    [l + w, t],
  ][part];
  return boxOf(fixed, to, width, height);
}
