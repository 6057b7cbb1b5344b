// A window of one stream's signal in columns, growing at its end while live. Times are relative to the origin.

import { rhythm, patience } from "./rhythm.js";

// Of what comes as it likes, a value is old after a second.
const OLD = 1e9;

const COLUMNS = ["t", "min", "max", "last", "n"];

export class Series {
  constructor() {
    this.length = 0;
    this.raw = true;
    this.sampled = false;
    // the longest span in ns of a row that holds several messages
    this.bin = 0;
    this.beat = { period: Infinity, row: 0 };
    this.capacity = 0;
    for (const c of COLUMNS) this[c] = new Float64Array(0);
  }

  // Takes over a decoded frame: rows at or after `from` are replaced by the frame's rows from there on.
  put(frame, base, from = -Infinity, bin = 0) {
    const append = from !== -Infinity;
    const keep = append ? lowerBound(this.t, from, this.length) : 0;
    const skip = append ? lowerBound(frame.t, from - base, frame.count) : 0;
    const n = frame.count - skip;
    this.reserve(keep + n, keep);
    for (let i = 0; i < n; i++) this.t[keep + i] = frame.t[skip + i] + base;
    for (const c of ["min", "max", "last", "n"]) this[c].set(frame[c].subarray(skip), keep);
    this.length = keep + n;
    this.raw = frame.raw && (keep === 0 || this.raw);
    this.bin = bin;
    this.sampled = frame.sampled === true;
    this.together = frame.together === true;
    this.beat = rhythm(this);
  }

  // How long a pause behind a row may be before messages are missing.
  patience(i) {
    return patience(this.beat, this.n[i]);
  }

  // Whether messages are missing between a row and the one before it: a line must not cross there.
  holeBefore(i) {
    return this.t[i] - this.t[i - 1] > this.patience(i - 1);
  }

  // How old the message of row `i` is at `t`, in ns; 0 while its successor is not due yet.
  age(i, t, at = this.t[i]) {
    const age = t - at;
    return age > Math.min(this.patience(i), Math.max(OLD, this.raw ? 0 : this.beat.row)) ? age : 0;
  }

  // Forgets rows before `from`, when that is worth a copy.
  trim(from) {
    const cut = lowerBound(this.t, from, this.length) - 1;
    if (cut < 1024 || cut < this.length / 2) return;
    for (const c of COLUMNS) this[c].copyWithin(0, cut, this.length);
    this.length -= cut;
  }

  reserve(n, keep) {
    if (n <= this.capacity) return;
    const capacity = Math.max(n, 256, this.capacity * 2);
    for (const c of COLUMNS) {
      const next = new Float64Array(capacity);
      next.set(this[c].subarray(0, keep));
      this[c] = next;
    }
    this.capacity = capacity;
  }

  // Index of the row in force at `t`: the last that starts at or before it; -1 before the first.
  at(t) {
    return upperBound(this.t, t, this.length) - 1;
  }

  // The end of a row: its last message is not after it.
  end(i) {
    const end = this.raw ? this.t[i] : this.t[i] + this.bin;
    return i + 1 < this.length ? Math.min(end, this.t[i + 1]) : end;
  }

  // The least difference between the values around a row; 0 where they are the same.
  spread(i) {
    if (i < 0) return 0;
    if (!this.raw && this.max[i] > this.min[i]) return (this.max[i] - this.min[i]) / Math.max(this.n[i], 1);
    const away = [i - 1, i + 1].map((k) => Math.abs(this.last[k] - this.last[i])).filter((d) => d > 0);
    return away.length ? Math.min(...away) : 0;
  }

  // Smallest and largest value among rows in [from, to] and the rows just outside.
  extent(from, to) {
    let a = Math.max(this.at(from), 0);
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

// The lines of one stream of maps, by name; one that ends is kept while some of it can be seen.
export function keepLines(old, lines, base, from, forget, bin) {
  const next = new Map(old);
  for (const line of lines) {
    const series = next.get(line.name) ?? new Series();
    series.put(line, base, from, bin);
    next.set(line.name, series);
  }
  for (const [name, s] of next) {
    s.trim(forget);
    if (!s.length || s.t[s.length - 1] < forget) next.delete(name);
  }
  return next;
}

// Names in the order people expect: numbers in them count by their size.
export const byName = new Intl.Collator("en", { numeric: true }).compare;

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
