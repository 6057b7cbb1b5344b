// Formats and parses times: clock times, durations, ruler steps, and the input of "go to time".

const US = 1e3,
  MS = 1e6,
  S = 1e9,
  MIN = 60 * S,
  H = 60 * MIN,
  D = 24 * H,
  W = 7 * D;

const STEPS = [
  1,
  2,
  5,
  10,
  20,
  50,
  100,
  200,
  500,
  US,
  2 * US,
  5 * US,
  10 * US,
  20 * US,
  50 * US,
  100 * US,
  200 * US,
  500 * US,
  MS,
  2 * MS,
  5 * MS,
  10 * MS,
  20 * MS,
  50 * MS,
  100 * MS,
  200 * MS,
  500 * MS,
  S,
  2 * S,
  5 * S,
  10 * S,
  15 * S,
  30 * S,
  MIN,
  2 * MIN,
  5 * MIN,
  10 * MIN,
  15 * MIN,
  30 * MIN,
  H,
  2 * H,
  6 * H,
  12 * H,
  D,
  2 * D,
  W,
  4 * W,
  13 * W,
  52 * W,
];

// Returns the smallest step that is at least `minPx` wide.
export function rulerStep(duration, px, minPx = 80) {
  const perPx = duration / Math.max(px, 1);
  return STEPS.find((s) => s / perPx >= minPx) ?? STEPS[STEPS.length - 1];
}

// Returns the ticks of a time range. `zero(unit)` is the time from which units are counted.
/** @param {number[]} range @param {number} px @param {number} minPx @param {(unit: number) => number} zero */
export function timeTicks([from, to], px, minPx = 80, zero = () => 0) {
  const unit = rulerStep(to - from, px, minPx);
  const z = zero(unit);
  const out = [];
  for (let i = Math.ceil((from - z) / unit); i * unit + z <= to; i++) out.push(i * unit + z);
  return { unit, at: out };
}

const padNumber = (n, w = 2) => String(n).padStart(w, "0");

// Formats a time relative to the start of the data: 83.25e9 -> "1:23.250". Decimals follow the ruler's unit, and so
// do days: "1d 2:03:04", or "1d" on a ruler of days.
export function formatRelative(t, unit = MS) {
  const neg = t < 0;
  const decimals = unit >= S ? 0 : unit >= MS ? 3 : unit >= US ? 6 : 9;
  const scale = 10 ** decimals;
  let n = Math.round((Math.abs(t) / S) * scale);
  const frac = n % scale;
  n = Math.floor(n / scale);
  const d = Math.floor(n / 86400),
    h = Math.floor(n / 3600) % 24,
    m = Math.floor(n / 60) % 60,
    s = n % 60;
  const tail = decimals ? "." + padNumber(frac, decimals) : "";
  const clock = d || h ? `${h}:${padNumber(m)}:${padNumber(s)}${tail}` : `${m}:${padNumber(s)}${tail}`;
  const text = unit >= D ? `${d}d` : d ? `${d}d ${clock}` : clock;
  return neg && (n || frac) ? "-" + text : text;
}

export function formatDuration(t) {
  const a = Math.abs(t),
    sign = t < 0 ? "-" : "";
  if (a < US) return `${sign}${a.toFixed(0)} ns`;
  if (a < MS) return `${sign}${formatDigits(a / US)} µs`;
  if (a < S) return `${sign}${formatDigits(a / MS)} ms`;
  if (a < MIN) return `${sign}${formatDigits(a / S)} s`;
  if (a < 10 * MIN) {
    // to a tenth of a second: 59.96 s is shown as a minute
    const tenths = Math.round(a / (S / 10));
    const rest = (tenths % 600) / 10;
    return `${sign}${Math.floor(tenths / 600)} min ${rest < 10 ? "0" : ""}${rest} s`;
  }
  if (a < H) return `${sign}${Math.floor(a / MIN)} min ${padNumber(Math.floor((a % MIN) / S))} s`;
  if (a < 2 * D) return `${sign}${Math.floor(a / H)} h ${padNumber(Math.floor((a % H) / MIN))} min`;
  return `${sign}${Math.floor(a / D)} d ${Math.floor((a % D) / H)} h`;
}

// The clocks of two machines are expected to differ by less than this.
const SKEW = 100 * MS;

// Formats a latency. Messages that were not created in real time, as in a replayed recording or a simulation, have
// none.
export const formatLatency = (t) => (t < -SKEW || t > D ? "not real time" : formatDuration(t));

function formatDigits(x) {
  return x >= 100 ? x.toFixed(0) : x >= 10 ? x.toFixed(1) : x.toFixed(2);
}

// Returns true for calendar dates. Times before 1971 count from the start of a simulation or of a file.
export const isCalendarDate = (ns) => ns > 31622400000000000n || ns < -31622400000000000n;

// Formats the absolute UTC time of `t` ns after the BigInt `origin`.
export function formatAbsolute(t, origin, decimals = 4) {
  const ns = origin + BigInt(Math.round(t));
  let s = ns / 1000000000n,
    f = ns % 1000000000n;
  if (f < 0n) {
    f += 1000000000n;
    s -= 1n;
  }
  const d = new Date(Number(s) * 1000);
  if (Number.isNaN(d.getTime())) return String(ns);
  const text = d.toISOString().slice(0, 19).replace("T", " ");
  return decimals ? `${text}.${padNumber(f.toString(), 9).slice(0, decimals)}` : text;
}

// Formats an absolute time to the nanosecond, as programs and "go to time" accept it.
export function formatIso(t, origin) {
  const ns = origin + BigInt(Math.round(t));
  const s = ns / 1000000000n - (ns % 1000000000n < 0n ? 1n : 0n);
  const date = new Date(Number(s) * 1000);
  if (Number.isNaN(date.getTime())) return String(ns);
  return `${date.toISOString().slice(0, 19)}.${padNumber(ns - s * 1000000000n, 9)}Z`;
}

// Parses "1:23.5", "2d 1:00:00", "83.5", "83.5 s", "250 ms", "2d" (from the start of the data),
// "2026-01-31T12:34:56.7Z" or integer nanoseconds since 1970; returns null for other texts.
export function parseTime(text, origin) {
  const x = text.trim();
  let m = /^(-?)(?:(\d+)\s*d\s+)?(?:(\d+):)?(\d+):(\d{1,2}(?:\.\d+)?)$/.exec(x);
  if (m) {
    const v = Number(m[2] ?? 0) * D + ((Number(m[3] ?? 0) * 60 + Number(m[4])) * 60 + Number(m[5])) * S;
    return m[1] ? -v : v;
  }
  m = /^(-?\d+(?:\.\d+)?)\s*(ns|us|µs|ms|s|min|h|d)?$/.exec(x);
  if (m && !m[2] && /^\d{15,}$/.test(x)) return Number(BigInt(x) - origin);
  if (m) return Number(m[1]) * { ns: 1, us: US, µs: US, ms: MS, s: S, min: MIN, h: H, d: D }[m[2] ?? "s"];
  m = /^(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d(?::\d\d)?)(?:\.(\d{1,9}))?(Z|[+-]\d\d:?\d\d)?$/.exec(x);
  if (!m) return null;
  const ms = Date.parse(`${m[1]}T${m[2].length === 5 ? m[2] + ":00" : m[2]}${m[4] ?? "Z"}`);
  if (Number.isNaN(ms)) return null;
  const ns = BigInt(ms) * 1000000n + BigInt((m[3] ?? "").padEnd(9, "0"));
  return Number(ns - origin);
}
