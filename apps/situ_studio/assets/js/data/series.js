// A window of one signal in columns. In live mode it grows at its end. Times are relative to the origin.

import { measureRhythm, gapThreshold } from "./gap_detection.js";

// Values of irregular data are old after a second.
const OLD = 1e9;

const COLUMNS = ["t", "min", "max", "last", "n"];

export class Series {
  constructor() {
    this.length = 0;
    this.raw = true;
    this.sampled = false;
    // the maximum time span in ns of a row that summarizes several messages
    this.bin = 0;
    this.beat = { period: Infinity, row: 0 };
    this.capacity = 0;
    this.t = this.min = this.max = this.last = this.n = new Float64Array(0);
  }

  // Stores a decoded frame: rows at or after `from` are replaced by the frame's rows.
  putFrame(frame, base, from = -Infinity, bin = 0) {
    const append = from !== -Infinity;
    const keep = append ? lowerBound(this.t, from, this.length) : 0;
    const skip = append ? lowerBound(frame.t, from - base, frame.count) : 0;
    const n = frame.count - skip;
    this.reserveRows(keep + n, keep);
    for (let i = 0; i < n; i++) this.t[keep + i] = frame.t[skip + i] + base;
    for (const c of ["min", "max", "last", "n"]) this[c].set(frame[c].subarray(skip), keep);
    this.length = keep + n;
    this.raw = frame.raw && (keep === 0 || this.raw);
    this.bin = bin;
    this.sampled = frame.sampled === true;
    this.together = frame.together === true;
    this.beat = measureRhythm(this);
  }

  // Returns how long the pause after a row may be before it is a gap.
  gapThreshold(i) {
    return gapThreshold(this.beat, this.n[i]);
  }

  // Returns true if messages are missing before row `i`; lines must not cross such a gap.
  hasGapBefore(i) {
    return this.t[i] - this.t[i - 1] > this.gapThreshold(i - 1);
  }

  // Returns the age in ns of the message of row `i` at time `t`, or 0 while the next message is not yet due.
  messageAge(i, t, at = this.t[i]) {
    const age = t - at;
    return age > Math.min(this.gapThreshold(i), Math.max(OLD, this.raw ? 0 : this.beat.row)) ? age : 0;
  }

  // Removes rows before `from` if there are enough to be worth a copy.
  trimBefore(from) {
    const cut = lowerBound(this.t, from, this.length) - 1;
    if (cut < 1024 || cut < this.length / 2) return;
    for (const c of COLUMNS) this[c].copyWithin(0, cut, this.length);
    this.length -= cut;
  }

  reserveRows(n, keep) {
    if (n <= this.capacity) return;
    const capacity = Math.max(n, 256, this.capacity * 2);
    for (const c of COLUMNS) {
      const next = new Float64Array(capacity);
      next.set(this[c].subarray(0, keep));
      this[c] = next;
    }
    this.capacity = capacity;
  }

  // Returns the index of the last row that starts at or before `t`, or -1 before the first row.
  indexAt(t) {
    return upperBound(this.t, t, this.length) - 1;
  }

  // Returns the end time of a row: none of its messages is later.
  rowEnd(i) {
    const end = this.raw ? this.t[i] : this.t[i] + this.bin;
    return i + 1 < this.length ? Math.min(end, this.t[i + 1]) : end;
  }

  // Returns the smallest non-zero difference between the values around a row, or 0.
  valueSpread(i) {
    if (i < 0) return 0;
    if (!this.raw && this.max[i] > this.min[i]) return (this.max[i] - this.min[i]) / Math.max(this.n[i], 1);
    const away = [i - 1, i + 1].map((k) => Math.abs(this.last[k] - this.last[i])).filter((d) => d > 0);
    return away.length ? Math.min(...away) : 0;
  }

  // Returns the smallest and largest value of the rows in [from, to] and of the rows just outside.
  valueExtent(from, to) {
    let a = Math.max(this.indexAt(from), 0);
    const b = Math.min(lowerBound(this.t, to, this.length), this.length - 1);
    let lo = Infinity,
      hi = -Infinity;
    for (; a <= b; a++) {
      if (this.min[a] < lo) lo = this.min[a];
      if (this.max[a] > hi) hi = this.max[a];
    }
    return lo <= hi ? [lo, hi] : null;
  }
}

// Merges the lines of a stream of maps by name. A line that has ended is kept while part of it may be visible.
export function keepLines(old, lines, base, from, forget, bin) {
  const next = new Map(old);
  for (const line of lines) {
    const series = next.get(line.name) ?? new Series();
    series.putFrame(line, base, from, bin);
    next.set(line.name, series);
  }
  for (const [name, s] of next) {
    s.trimBefore(forget);
    if (!s.length || s.t[s.length - 1] < forget) next.delete(name);
  }
  return next;
}

// Compares names in natural order: numbers in them count by value.
export const compareNames = new Intl.Collator("en", { numeric: true }).compare;

export function lowerBound(a, x, n = a.length) {
  let lo = 0,
    hi = n;
  while (lo < hi) {
    const mid = (lo + hi) >> 1;
    if (a[mid] < x) lo = mid + 1;
    else hi = mid;
  }
  return lo;
}

export function upperBound(a, x, n = a.length) {
  let lo = 0,
    hi = n;
  while (lo < hi) {
    const mid = (lo + hi) >> 1;
    if (a[mid] <= x) lo = mid + 1;
    else hi = mid;
  }
  return lo;
}
