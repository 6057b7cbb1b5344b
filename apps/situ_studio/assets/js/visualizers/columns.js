// Rows of more messages than pixels as columns of pixels, each from the least to the greatest value of the messages in
// it. Pure.

// The columns `left` <= c < right of the rows a..b of a series; `x` maps a time to pixels. A row that reaches over the
// edge of a column belongs to both. Returns {left, lo, hi, joins}: of each column the least and the greatest value (NaN
// where it is empty), and lines [c0, v0, c1, v1] across empty columns, where messages are farther apart than pixels.
// Without a hole between them neighbours touch: a column reaches as far as the last value before it.
export function columns(s, a, b, x, left, right) {
  const n = Math.max(right - left, 0);
  const lo = new Float64Array(n).fill(NaN),
    hi = new Float64Array(n).fill(NaN);
  const joins = [];
  const put = (c, least, most) => {
    const k = c - left;
    if (k < 0 || k >= n) return;
    if (!(lo[k] <= least)) lo[k] = least;
    if (!(hi[k] >= most)) hi[k] = most;
  };
  let before = null;
  for (let i = a; i <= b; i++) {
    if (!Number.isFinite(s.min[i]) || !Number.isFinite(s.max[i])) {
      before = null;
      continue;
    }
    const c0 = Math.floor(x(s.t[i]));
    const c1 = Math.max(c0, Math.ceil(x(s.end(i))) - 1);
    for (let c = Math.max(c0, left); c <= Math.min(c1, right - 1); c++) put(c, s.min[i], s.max[i]);
    if (before && !s.holeBefore(i)) {
      const near = clamp(before.v, s.min[i], s.max[i]);
      if (c0 > before.c + 1) joins.push([before.c, before.v, c0, near]);
      else put(c0, Math.min(near, before.v), Math.max(near, before.v));
    }
    before = { c: c1, v: Number.isFinite(s.last[i]) ? s.last[i] : clamp(0, s.min[i], s.max[i]) };
  }
  return { left, lo, hi, joins };
}

const clamp = (v, lo, hi) => Math.min(Math.max(v, lo), hi);

// The first pixel and the height of a stroke: it covers all pixels between two heights, and at least `least`.
export function strokeOf(top, bottom, least) {
  const from = Math.floor(top),
    to = Math.max(Math.ceil(bottom), from + 1);
  const missing = Math.max(least - (to - from), 0);
  return [from - Math.floor(missing / 2), to - from + missing];
}
