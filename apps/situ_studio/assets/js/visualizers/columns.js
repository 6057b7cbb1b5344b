// Summarizes rows of more messages than pixels as columns of pixels, each from the minimum to the maximum of its
// messages. Pure.

// Returns the columns `left` <= c < right of the rows a..b of a series; `x` maps a time to pixels. A row that
// crosses the edge of a column belongs to both. The result is {left, lo, hi, joins}: the minimum and maximum of each
// column (NaN if it is empty), and lines [c0, v0, c1, v1] across empty columns if messages are farther apart than
// pixels. Without a gap between them neighbors touch: a column extends to the last value before it.
export function pixelColumns(s, a, b, x, left, right) {
  const n = Math.max(right - left, 0);
  const lo = new Float64Array(n).fill(NaN),
    hi = new Float64Array(n).fill(NaN);
  const joins = [];
  const widenColumn = (c, least, most) => {
    const k = c - left;
    if (k < 0 || k >= n) return;
    if (!(lo[k] <= least)) lo[k] = least;
    if (!(hi[k] >= most)) hi[k] = most;
  };
  /** @type {{c: number, v: number} | null} */
  let before = null;
  for (let i = a; i <= b; i++) {
    if (!Number.isFinite(s.min[i]) || !Number.isFinite(s.max[i])) {
      before = null;
      continue;
    }
    const c0 = Math.floor(x(s.t[i]));
    const c1 = Math.max(c0, Math.ceil(x(s.rowEnd(i))) - 1);
    for (let c = Math.max(c0, left); c <= Math.min(c1, right - 1); c++) widenColumn(c, s.min[i], s.max[i]);
    if (before && !s.hasGapBefore(i)) {
      const near = clamp(before.v, s.min[i], s.max[i]);
      if (c0 > before.c + 1) joins.push([before.c, before.v, c0, near]);
      else widenColumn(c0, Math.min(near, before.v), Math.max(near, before.v));
    }
    before = { c: c1, v: Number.isFinite(s.last[i]) ? s.last[i] : clamp(0, s.min[i], s.max[i]) };
  }
  return { left, lo, hi, joins };
}

const clamp = (v, lo, hi) => Math.min(Math.max(v, lo), hi);

// Returns the first pixel and the height of a stroke: it covers all pixels between two heights, and at least
// `least`.
export function strokeSpan(top, bottom, least) {
  const from = Math.floor(top),
    to = Math.max(Math.ceil(bottom), from + 1);
  const missing = Math.max(least - (to - from), 0);
  return [from - Math.floor(missing / 2), to - from + missing];
}
