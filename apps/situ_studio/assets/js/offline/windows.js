// Builds the windows of an exported page from its messages, as the server does for a page of the studio. Pure.
//
// Times are in ns since the start of the page's data. Columns are {t, min, max, last, n, count}.

import { lowerBound, upperBound } from "../data/series.js";

// As in the studio, a window with more points or segments than this is summarized.
const MOST_POINTS = 4_000,
  MOST_SEGMENTS = 3_000;

const COLUMNS = ["t", "min", "max", "last", "n"];

/**
 * @typedef {object} Columns
 * @property {Float64Array} t
 * @property {Float64Array} min
 * @property {Float64Array} max
 * @property {Float64Array} last
 * @property {Float64Array} n
 * @property {number} count
 * @property {boolean} [raw]
 */

/** @typedef {[from: number, to: number | null, label: string, cls: string, lane: string]} Segment */

/**
 * Joins consecutive parts of one line. A part may repeat the last points of the part before it.
 * @param {{base: number, columns: Columns}[]} parts
 * @returns {Columns}
 */
export function joinColumns(parts) {
  const size = parts.reduce((sum, { columns }) => sum + columns.count, 0);
  const out = emptyColumns(size);
  let at = 0,
    last = -Infinity;
  for (const { base, columns } of parts) {
    for (let i = 0; i < columns.count; i++) {
      const t = base + columns.t[i];
      if (t <= last) continue;
      last = out.t[at] = t;
      for (const c of ["min", "max", "last", "n"]) out[c][at] = columns[c][i];
      at++;
    }
  }
  return cutColumns(out, 0, at);
}

/**
 * Returns the points in [from, to] and one on each side, in bins if there are many of them.
 * @param {Columns} columns
 * @param {number} from
 * @param {number} to
 * @param {number} bin in ns
 * @returns {Columns}
 */
export function cutWindow(columns, from, to, bin) {
  const a = Math.max(upperBound(columns.t, from) - 1, 0);
  const b = Math.min(lowerBound(columns.t, to) + 1, columns.count);
  const within = cutColumns(columns, a, Math.max(a, b));
  if (within.count <= MOST_POINTS) return { ...within, raw: columns.raw };
  return { ...foldColumns(within, bin), raw: false };
}

/**
 * Folds points into bins. A gap (NaN) is visible only if its bin contains nothing else.
 * @param {Columns} columns
 * @param {number} bin
 * @returns {Columns}
 */
export function foldColumns(columns, bin) {
  const out = emptyColumns(columns.count);
  let at = -1,
    open = NaN;
  for (let i = 0; i < columns.count; i++) {
    const index = Math.floor(columns.t[i] / bin);
    if (index !== open) {
      at++;
      open = index;
      for (const c of COLUMNS) out[c][at] = columns[c][i];
      continue;
    }
    out.n[at] += columns.n[i];
    if (Number.isNaN(columns.min[i])) continue;
    out.min[at] = Number.isNaN(out.min[at]) ? columns.min[i] : Math.min(out.min[at], columns.min[i]);
    out.max[at] = Number.isNaN(out.max[at]) ? columns.max[i] : Math.max(out.max[at], columns.max[i]);
    out.last[at] = columns.last[i];
  }
  return cutColumns(out, 0, at + 1);
}

/**
 * Joins consecutive parts of the lanes of a stream. A state that continues from one part to the next is one segment.
 * @param {{base: number, rows: any[]}[]} parts
 * @returns {Segment[]} by lane, in order
 */
export function joinSegments(parts) {
  /** @type {Map<string, Segment[]>} */
  const lanes = new Map();
  for (const { base, rows } of parts) {
    for (const [a, b, label, cls, lane = ""] of rows) {
      if (!lanes.has(lane)) lanes.set(lane, []);
      const held = /** @type {Segment[]} */ (lanes.get(lane));
      const last = held[held.length - 1];
      const joins = last && cls !== "text" && cls !== "span" && last[1] === a + base;
      if (joins && last[2] === label && last[3] === cls) last[1] = b == null ? null : b + base;
      else held.push([a + base, b == null ? null : b + base, label, cls, lane]);
    }
  }
  return [...lanes.values()].flat();
}

/**
 * Returns the segments that are visible in [from, to]. If there are many, adjacent ones that are shorter than `least`
 * become one of the class "many" with the number of changes.
 * @param {Segment[]} rows
 * @param {number} from
 * @param {number} to
 * @param {number} least
 * @returns {Segment[]}
 */
export function cutSegments(rows, from, to, least) {
  const seen = rows.filter(([a, b]) => a <= to && (b === null || b >= from));
  if (seen.length <= MOST_SEGMENTS) return seen;
  /** @type {(Segment & {count?: number})[]} */
  const out = [];
  for (const row of seen) {
    const last = out[out.length - 1];
    const [a, b, , cls, lane] = row;
    const short = b !== null && b - a < least && !["many", "text", "span"].includes(cls);
    const joins = short && last && last[4] === lane && last[1] === a;
    if (joins && (last.count || a - last[0] < least)) {
      last[1] = b;
      last.count = (last.count ?? 1) + 1;
    } else out.push(/** @type {Segment} */ ([...row]));
  }
  for (const row of out) if (row.count) [row[2], row[3]] = [`${row.count} changes`, "many"];
  return out;
}

/**
 * Returns the index of the message to show at a time, or -1: the last one before, or a later one that is nearer.
 * `past` and `future` limit how far away it may be, in ns.
 * @param {ArrayLike<number>} times
 * @param {number} t
 * @param {{past?: number, future?: number}} [reach]
 */
export function findMessage(times, t, { past = Infinity, future = 0 } = {}) {
  const next = upperBound(times, t);
  const before = next > 0 && t - times[next - 1] <= past ? next - 1 : -1;
  if (next >= times.length || !(times[next] - t <= future)) return before;
  return before >= 0 && t - times[before] <= times[next] - t ? before : next;
}

/** @param {number} count @returns {Columns} */
function emptyColumns(count) {
  const make = () => new Float64Array(count);
  return { t: make(), min: make(), max: make(), last: make(), n: make(), count };
}

/** @param {Columns} columns @param {number} a @param {number} b @returns {Columns} */
function cutColumns(columns, a, b) {
  const cut = (c) => columns[c].slice(a, b);
  return { t: cut("t"), min: cut("min"), max: cut("max"), last: cut("last"), n: cut("n"), count: b - a };
}
