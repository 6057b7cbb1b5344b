// Formats numbers for display.

// Formats a number with six significant digits.
export function formatNumber(x, digits = 6) {
  if (x == null) return "";
  if (!Number.isFinite(x)) return Number.isNaN(x) ? "NaN" : x > 0 ? "inf" : "-inf";
  if (Number.isInteger(x) && Math.abs(x) < 1e15) return String(x);
  const a = Math.abs(x);
  if (a !== 0 && (a < 1e-4 || a >= 1e9)) return x.toExponential(3);
  return String(Number(x.toPrecision(digits)));
}

// Numbers with at most this many digits are shown in full, since people wrote them. Longer ones were computed.
const WHOLE = 12;
// The minimum and maximum number of significant digits of a computed number; 17 distinguish all floats.
const LEAST = 6,
  MOST = 17;

// Shortens the exact text of a number: in full, or with as many digits as distinguish it from a number that is
// `apart` away. Other texts are returned unchanged.
export function valueText(exact, apart = 0) {
  const x = Number(exact);
  if (!Number.isFinite(x) || exact.trim() === "") return exact;
  // An integer may be too large for an exact number.
  if (/^-?\d+$/.test(exact)) return exact;
  const whole = String(x);
  const written = whole.replace(/e.*/, "").replace(/^-?0*\.?0*|\./g, "").length;
  if (written <= WHOLE) return whole;
  return String(Number(x.toPrecision(digitsFor(x, apart, LEAST))));
}

// Returns the number of significant digits that distinguish x from a number that is `apart` away, at least `least`.
function digitsFor(x, apart, least) {
  if (!(apart > 0) || x === 0) return least;
  const digits = Math.floor(Math.log10(Math.abs(x))) - Math.floor(Math.log10(apart)) + 2;
  return Math.min(Math.max(digits, least), MOST);
}

/** @type {[factor: number, letter: string][]} */
const SI = [
  [1e12, "T"],
  [1e9, "G"],
  [1e6, "M"],
  [1e3, "k"],
];

// Formats a number on an axis whose ticks are `step` apart: short, with SI prefixes for large numbers, but with
// enough digits to differ from its neighbors.
export function axisNumber(x, step = 0) {
  const a = Math.abs(x);
  const digits = digitsFor(x, step, 4);
  if (a >= 1e15 || (a < 1e-4 && a > 0)) {
    return x
      .toExponential(Math.max(digits - 2, 2))
      .replace(/(\.\d*?)0*e\+?/, "$1e")
      .replace(".e", "e");
  }
  // The ticks are round, so digits beyond their step are noise.
  if (a < 10000 || digits > LEAST) return String(Number(x.toPrecision(Math.max(digits, 4))));
  const [factor, letter] = SI.find(([f]) => a >= f) ?? [1, ""];
  return `${Number((x / factor).toPrecision(digits))} ${letter}`;
}

// Returns the number of ticks of a value axis of `px` pixels: dense on low axes, sparse on high ones.
export const tickCount = (px) => Math.max(2, Math.min(Math.floor(px / 24), 4 + Math.floor(px / 80)));

// Returns the ticks of a value axis from lo to hi: about n, never a single one, at 1, 2 or 5 times a power of ten.
export function valueTicks(lo, hi, n) {
  // A span that overflows is divided as a quarter of it.
  if (hi - lo === Infinity) return valueTicks(lo / 4, hi / 4, n).map((v) => v * 4);
  for (let k = n; k <= 4 * n + 8; k++) {
    const found = roundTicks(lo, hi, k);
    if (found.length >= 2 || !found.length) return found;
  }
  return roundTicks(lo, hi, n);
}

function roundTicks(lo, hi, n) {
  const span = hi - lo;
  if (!(span > 0) || !Number.isFinite(span)) return [];
  const raw = span / Math.max(n, 1);
  const mag = 10 ** Math.floor(Math.log10(raw));
  const unit = [1, 2, 5, 10].map((k) => k * mag).find((u) => u >= raw) ?? raw;
  const out = [];
  // Numbers that differ only in their last digits have no round numbers between them, and counting in their units does
  // not change them.
  if (!(Math.max(Math.abs(lo), Math.abs(hi)) / unit < Number.MAX_SAFE_INTEGER / 4)) return [lo, hi];
  // The digits of a tick end where those of its unit end.
  const digits = Math.ceil(Math.log10(Math.max(Math.abs(lo), Math.abs(hi)) / unit)) + 2;
  for (let i = Math.ceil(lo / unit); i * unit <= hi + unit * 1e-9; i++)
    out.push(Number((i * unit).toPrecision(Math.min(Math.max(digits, WHOLE), MOST))));
  return out;
}

// Returns the range of the extents padded by 10 % on both sides: 0..1 without extents, one unit around a single
// value.
export function paddedRange(extents) {
  let lo = Infinity,
    hi = -Infinity;
  for (const e of extents) {
    if (!e) continue;
    if (Number.isFinite(e[0]) && e[0] < lo) lo = e[0];
    if (Number.isFinite(e[1]) && e[1] > hi) hi = e[1];
  }
  if (lo > hi) return [0, 1];
  const pad = lo === hi ? Math.max(Math.abs(lo) * 0.1, 0.5) : hi / 10 - lo / 10;
  return [Math.max(lo - pad, -Number.MAX_VALUE), Math.min(hi + pad, Number.MAX_VALUE)];
}

// Returns the position of a value between lo (0) and hi (1), even if their difference overflows.
export const valueFraction = (v, lo, hi) =>
  hi - lo === Infinity ? (v / 4 - lo / 4) / (hi / 4 - lo / 4) : (v - lo) / (hi - lo);
