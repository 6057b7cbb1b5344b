// Numbers for people.

// Six significant digits, no noise.
export function number(x, digits = 6) {
  if (x == null) return "";
  if (!Number.isFinite(x)) return Number.isNaN(x) ? "NaN" : x > 0 ? "inf" : "-inf";
  if (Number.isInteger(x) && Math.abs(x) < 1e15) return String(x);
  const a = Math.abs(x);
  if (a !== 0 && (a < 1e-4 || a >= 1e9)) return x.toExponential(3);
  return String(Number(x.toPrecision(digits)));
}

// Numbers with at most this many digits are shown whole: people wrote them. Longer ones were computed.
const WHOLE = 12;
// The fewest and the most significant digits of a computed number; 17 tell all floats apart.
const LEAST = 6,
  MOST = 17;

// Shortens the exact text of a number: whole, or with as many digits as distinguish it from a number that is `apart`
// away. Other texts stay as they are.
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

// The number of significant digits that distinguish x from a number that is `apart` away, at least `least`.
function digitsFor(x, apart, least) {
  if (!(apart > 0) || x === 0) return least;
  const digits = Math.floor(Math.log10(Math.abs(x))) - Math.floor(Math.log10(apart)) + 2;
  return Math.min(Math.max(digits, least), MOST);
}

const SI = [
  [1e12, "T"],
  [1e9, "G"],
  [1e6, "M"],
  [1e3, "k"],
];

// A number on an axis whose ticks are `step` apart: short, with SI prefixes for large numbers, but with enough digits
// to differ from its neighbours.
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
  const [factor, letter] = SI.find(([f]) => a >= f);
  return `${Number((x / factor).toPrecision(digits))} ${letter}`;
}

// How many ticks a value axis of so many pixels has: close ones where it is low, few where it is high.
export const tickCount = (px) => Math.max(2, Math.min(Math.floor(px / 24), 4 + Math.floor(px / 80)));

// Ticks of a value axis between lo and hi, about n of them and never one alone, at 1, 2 or 5 times a power of ten.
export function valueTicks(lo, hi, n) {
  // A span that overflows is divided as a quarter of it.
  if (hi - lo === Infinity) return valueTicks(lo / 4, hi / 4, n).map((v) => v * 4);
  for (let k = n; k <= 4 * n + 8; k++) {
    const found = ticksOf(lo, hi, k);
    if (found.length >= 2 || !found.length) return found;
  }
  return ticksOf(lo, hi, n);
}

function ticksOf(lo, hi, n) {
  const span = hi - lo;
  if (!(span > 0) || !Number.isFinite(span)) return [];
  const raw = span / Math.max(n, 1);
  const mag = 10 ** Math.floor(Math.log10(raw));
  const unit = [1, 2, 5, 10].map((k) => k * mag).find((u) => u >= raw) ?? raw;
  const out = [];
  // The digits of a tick end where those of its unit end.
  const digits = Math.ceil(Math.log10(Math.max(Math.abs(lo), Math.abs(hi)) / unit)) + 2;
  for (let i = Math.ceil(lo / unit); i * unit <= hi + unit * 1e-9; i++)
    out.push(Number((i * unit).toPrecision(Math.min(Math.max(digits, WHOLE), MOST))));
  return out;
}

// min..max padded by 10 % on both sides; nothing gives 0..1, a single value one unit around it.
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

// The position of a value between lo (0) and hi (1), also where their difference overflows.
export const fraction = (v, lo, hi) =>
  hi - lo === Infinity ? (v / 4 - lo / 4) / (hi / 4 - lo / 4) : (v - lo) / (hi - lo);
