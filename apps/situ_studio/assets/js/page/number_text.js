// Numbers for people: six significant digits, no noise.
export function number(x, digits = 6) {
  if (x == null) return "";
  if (!Number.isFinite(x)) return Number.isNaN(x) ? "NaN" : x > 0 ? "inf" : "-inf";
  if (Number.isInteger(x) && Math.abs(x) < 1e15) return String(x);
  const a = Math.abs(x);
  if (a !== 0 && (a < 1e-4 || a >= 1e9)) return x.toExponential(3);
  return String(Number(x.toPrecision(digits)));
}

const SI = [
  [1e12, "T"],
  [1e9, "G"],
  [1e6, "M"],
  [1e3, "k"],
];

// A number beside an axis: short, large ones with the prefixes of SI.
export function axisNumber(x) {
  const a = Math.abs(x);
  if (a >= 1e15 || (a < 1e-4 && a > 0)) return x.toExponential(2).replace(/\.?0*e\+?/, "e");
  if (a < 10000) return number(x, 4);
  const [factor, letter] = SI.find(([f]) => a >= f);
  return `${number(x / factor, 4)} ${letter}`;
}

// How many ticks a value axis of so many pixels has: close ones where it is low, few where it is high.
export const tickCount = (px) => Math.max(2, Math.min(Math.floor(px / 24), 4 + Math.floor(px / 80)));

// Ticks of a value axis between lo and hi, about n of them and never one alone, at 1, 2 or 5 times a power of ten.
export function valueTicks(lo, hi, n) {
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
  for (let i = Math.ceil(lo / unit); i * unit <= hi + unit * 1e-9; i++) out.push(Number((i * unit).toPrecision(12)));
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
  if (lo === hi) return [lo - Math.max(Math.abs(lo) * 0.1, 0.5), hi + Math.max(Math.abs(hi) * 0.1, 0.5)];
  const pad = (hi - lo) * 0.1;
  return [lo - pad, hi + pad];
}
