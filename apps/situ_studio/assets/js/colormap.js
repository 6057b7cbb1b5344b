// Depth as pseudo-colour, near is warm. Value 0 means "no reading" and is drawn transparent.

const STOPS = [
  [122, 18, 24], [214, 62, 38], [246, 142, 50], [247, 214, 78],
  [150, 214, 110], [52, 178, 166], [40, 112, 190], [44, 44, 120],
];

export const TABLE = Array.from({ length: 256 }, (_, i) => {
  const at = (i / 255) * (STOPS.length - 1);
  const k = Math.min(Math.floor(at), STOPS.length - 2);
  const f = at - k;
  return STOPS[k].map((c, j) => Math.round(c + (STOPS[k + 1][j] - c) * f));
});

export function depthRange(depth) {
  let lo = 65535, hi = 0;
  for (let i = 0; i < depth.length; i++) {
    const d = depth[i];
    if (d === 0) continue;
    if (d < lo) lo = d;
    if (d > hi) hi = d;
  }
  return hi > lo ? [lo, hi] : [0, Math.max(hi, 1)];
}

export function paintDepth(depth, rgba, [lo, hi]) {
  const k = 255 / (hi - lo);
  for (let i = 0; i < depth.length; i++) {
    const d = depth[i];
    const o = 4 * i;
    if (d === 0) {
      rgba[o + 3] = 0;
      continue;
    }
    const c = TABLE[Math.min(Math.max(Math.round((d - lo) * k), 0), 255)];
    rgba[o] = c[0];
    rgba[o + 1] = c[1];
    rgba[o + 2] = c[2];
    rgba[o + 3] = 255;
  }
}
