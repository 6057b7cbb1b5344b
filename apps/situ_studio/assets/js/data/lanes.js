// The lanes of one stream: marks of messages, and segments of states, texts and intervals. Pure.

import { compareNames, lowerBound } from "./series.js";
import { formatDuration, formatLatency, formatRelative } from "../time/text.js";

const MOST_MARKS = 20000,
  MOST_SEGMENTS = 5000;

export function keepMarks(old, f, base, from) {
  const t = Array.from(f.t, (x) => x + base);
  const latency = Array.from(f.latency);
  if (!old) return { t, latency };
  const keep = old.t.findIndex((x) => x >= from);
  const n = keep < 0 ? old.t.length : keep;
  const start = Math.max(0, n - MOST_MARKS);
  return { t: old.t.slice(start, n).concat(t), latency: old.latency.slice(start, n).concat(latency) };
}

// Groups segments by lane: a Map from name to [[start, end, label, class], ...]. An end of Infinity means still
// open.
export function keepSegments(old, rows, base, from) {
  const next = new Map();
  for (const [a, b, label, cls, lane = ""] of rows) {
    if (!next.has(lane)) next.set(lane, []);
    next.get(lane).push([a + base, b == null ? Infinity : b + base, label, cls]);
  }
  if (!old) return next;
  for (const [lane, held] of old) {
    const rest = joinSegments(held, next.get(lane) ?? [], from);
    if (rest.length) next.set(lane, rest);
  }
  return next;
}

// Joins the rows held before the new window with its rows. A state that continues across the seam becomes one
// segment.
function joinSegments(held, next, from) {
  const first = next.length ? next[0][0] : from;
  if ((next[0] ?? held[0])[3] === "span") {
    const starts = new Set(next.map(([a]) => a));
    return held
      .filter(([a]) => !starts.has(a))
      .slice(-MOST_SEGMENTS)
      .concat(next)
      .sort((p, q) => p[0] - q[0]);
  }
  const kept = held.filter(([a]) => a < first).slice(-MOST_SEGMENTS);
  const last = kept[kept.length - 1];
  if (!last || last[1] < first) return kept.concat(next);
  const [head, ...tail] = next;
  if (head && head[2] === last[2] && head[3] === last[3] && last[3] !== "text") {
    return kept.slice(0, -1).concat([[last[0], head[1], head[2], head[3]]], tail);
  }
  kept[kept.length - 1] = [last[0], first, last[2], last[3]];
  return kept.concat(next);
}

// Returns the sorted lane names of a stream; a single empty name if its lanes have no names.
export function laneNames(segments) {
  const names = [...(segments?.keys() ?? [])].sort(compareNames);
  return names.length ? names : [""];
}

// Returns the segment at a time (the one that began last if several overlap), or null. `slack` widens narrow
// segments.
export function segmentAt(segments, t, slack) {
  for (let i = segments.length - 1; i >= 0; i--) {
    const [a, b] = segments[i];
    if (t >= a - slack && t <= Math.max(b, a + slack)) return segments[i];
  }
  return null;
}

// Describes a segment as lines of text; `show` formats a time.
export function segmentText([a, b, label, cls], show = formatRelative) {
  const what = label || { true: "true" }[cls];
  const when = b === Infinity ? `since ${show(a)}` : `${show(a)} to ${show(b)}, ${formatDuration(b - a)}`;
  return what ? [what, when] : [when];
}

// Describes the message nearest to a time within `slack`; returns no lines if there is none.
export function markText({ t: times, latency: late }, t, slack, show = formatRelative) {
  const i = lowerBound(times, t);
  const near = [i - 1, i].filter((k) => k >= 0 && k < times.length && Math.abs(times[k] - t) <= slack);
  if (!near.length) return [];
  const k = near.reduce((p, q) => (Math.abs(times[q] - t) < Math.abs(times[p] - t) ? q : p));
  return [`message at ${show(times[k])}`, `latency ${formatLatency(late[k])}`];
}
