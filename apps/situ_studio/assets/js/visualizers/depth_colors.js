// Depth as false colors, warm when near: the range that the colors cover, and the value that means "no reading".
// Pure.

/** @typedef {[red: number, green: number, blue: number]} Rgb */

/** @type {Rgb[]} */
const STOPS = [
  [122, 18, 24],
  [214, 62, 38],
  [246, 142, 50],
  [247, 214, 78],
  [150, 214, 110],
  [52, 178, 166],
  [40, 112, 190],
  [44, 44, 120],
];

/** @type {Rgb[]} */
export const COLORS = Array.from({ length: 256 }, (_, i) => {
  const at = (i / 255) * (STOPS.length - 1);
  const k = Math.min(Math.floor(at), STOPS.length - 2);
  const f = at - k;
  const mix = (j) => Math.round(STOPS[k][j] + (STOPS[k + 1][j] - STOPS[k][j]) * f);
  return [mix(0), mix(1), mix(2)];
});

/** @param {Rgb} color @param {number} a */
const packColor = ([r, g, b], a = 255) => ((a << 24) | (b << 16) | (g << 8) | r) >>> 0;
const PACKED = Uint32Array.from(COLORS, (c) => packColor(c));

// The ranges of sensor modes in mm; the names match the server's table of visualizers.
const RANGES = {
  all: [0, 65535],
  nfov_binned: [500, 5460],
  nfov: [500, 3860],
  wfov_binned: [250, 2880],
  wfov: [250, 2210],
};

// Returns the visualizer's properties as {range, invalid, none}: `range` is null if each image has its own,
// `invalid` is the value that is not a reading (null: every value is one), `none` is the packed color of such
// values.
/**
 * @param {{range?: string, min?: number, max?: number, invalid?: number, invalid_color?: string}} props
 * @returns {{range: [number, number] | null, invalid: number | null, none: number}}
 */
export function depthStyle({ range = "auto", min, max, invalid = 0, invalid_color: color } = {}) {
  return {
    range: range === "fixed" ? orderedRange(min ?? 0, max ?? 65535) : (RANGES[range] ?? null),
    invalid: invalid < 0 ? null : invalid,
    none: color ? packColor(parseRgb(color)) : 0,
  };
}

// Parses "#rrggbb".
/** @param {string} color @returns {Rgb} */
export function parseRgb(color) {
  const packed = parseInt(color.slice(1), 16);
  return [packed >> 16, (packed >> 8) & 255, packed & 255];
}

// Returns an ordered, non-empty range.
/** @returns {[number, number]} */
function orderedRange(a, b) {
  const lo = Math.min(a, b),
    hi = Math.max(a, b);
  return hi > lo ? [lo, hi] : [lo, lo + 1];
}

// Returns the lowest and highest reading of an image.
/** @param {Uint16Array} depth @param {number | null} invalid @returns {[number, number]} */
export function depthRange(depth, invalid = 0) {
  let lo = 65535,
    hi = 0;
  for (let i = 0; i < depth.length; i++) {
    const d = depth[i];
    if (d === invalid) continue;
    if (d < lo) lo = d;
    if (d > hi) hi = d;
  }
  return hi < lo ? [0, 1] : orderedRange(lo, hi);
}

// Colors `depth` into the bytes `rgba`; readings beyond the range get the color of its nearer end. Returns the
// range.
export function paintDepth(depth, rgba, { range, invalid, none }) {
  const used = range ?? depthRange(depth, invalid);
  const [lo, hi] = used;
  const k = 255 / (hi - lo);
  const out = new Uint32Array(rgba.buffer, rgba.byteOffset, depth.length);
  for (let i = 0; i < depth.length; i++) {
    const d = depth[i];
    out[i] = d === invalid ? none : PACKED[d <= lo ? 0 : d >= hi ? 255 : Math.round((d - lo) * k)];
  }
  return used;
}

// Colors a 16-bit image that is not depth, such as infrared, in gray from its darkest to its brightest value.
export function paintGray(values, rgba) {
  const [lo, hi] = depthRange(values, null);
  const k = 255 / (hi - lo);
  const out = new Uint32Array(rgba.buffer, rgba.byteOffset, values.length);
  for (let i = 0; i < values.length; i++) {
    const g = Math.round((values[i] - lo) * k);
    out[i] = packColor([g, g, g]);
  }
}

// Formats a reading; `unit` is micrometers for a value of 1, or 0 if unknown.
export function formatDistance(value, unit) {
  if (!unit) return String(value);
  const m = (value * unit) / 1e6;
  return m >= 100 ? `${m.toFixed(1)} m` : m >= 1 ? `${m.toFixed(2)} m` : `${Number((m * 1000).toPrecision(4))} mm`;
}
