// One language for times everywhere on the page: UTC, this browser's local time, since the start of the data, or since
// the start of the selection.

import { absolute, dated, parseTime, relative, ticks } from "./text.js";
import { choose, onSetting, setting } from "../page/settings.js";

export const MODES = [
  ["utc", "UTC"],
  ["local", "local"],
  ["start", "since start"],
  ["selection", "since selection"],
];

// How many pixels a letter of the ruler takes, and the room between two labels.
const LETTER = 6.6,
  BETWEEN = 16;

let chosen = setting("clock");
// Where the selection starts, or the data where there is none.
let since = 0;
const listeners = new Set();

onSetting((id, value) => {
  if (id !== "clock") return;
  chosen = value;
  for (const l of listeners) l(chosen);
});

export const clockMode = () => chosen;

// Times that are not calendar dates are shown since the start, whatever clock is chosen.
const modeOf = (origin) => (chosen !== "selection" && (origin === null || !dated(origin)) ? "start" : chosen);

export function nextClock() {
  const i = MODES.findIndex(([m]) => m === chosen);
  choose("clock", MODES[(i + 1) % MODES.length][0]);
}

export function onClock(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

// The selection starts elsewhere; whether that changes what is shown.
export function setSelected(t) {
  const next = t ?? 0;
  if (next === since) return false;
  since = next;
  return chosen === "selection";
}

// Nanoseconds that local time is ahead of UTC then.
function ahead(t, origin) {
  const ms = Number((origin + BigInt(Math.round(t))) / 1000000n);
  return -new Date(ms).getTimezoneOffset() * 60e9;
}

// A time of the page for people; `unit` is how fine it has to be, as of the ruler's ticks.
export function shown(t, origin, unit = 1e6) {
  const mode = modeOf(origin);
  if (mode === "selection") return relative(t - since, unit);
  if (mode === "start") return relative(t, unit);
  const decimals = unit >= 1e9 ? 0 : unit >= 1e6 ? 3 : unit >= 1e3 ? 6 : 9;
  const text = absolute(t + (mode === "local" ? ahead(t, origin) : 0), origin, decimals);
  return unit >= 86400e9 ? text.slice(0, 10) : text.slice(11);
}

// The time from which the ruler counts its units: round times have round names.
function zero(origin) {
  const mode = modeOf(origin);
  if (mode === "selection") return () => since;
  if (mode === "start") return () => 0;
  return (unit) => {
    const clock = origin + (mode === "local" ? BigInt(ahead(0, origin)) : 0n);
    return -Number(clock % BigInt(unit));
  };
}

// The ticks of a ruler of so many pixels, with room for their names.
export function rulerTicks(view, px, origin, minPx = 90) {
  const found = ticks(view, px, minPx, zero(origin));
  const name = shown(found.at[0] ?? view[0], origin, found.unit);
  const need = name.length * LETTER + BETWEEN;
  return need > minPx ? ticks(view, px, need, zero(origin)) : found;
}

// The day and the zone, for a caption.
export function day(t, origin) {
  const mode = modeOf(origin);
  if (mode === "selection") return "since selection";
  if (mode === "start") return "since start";
  const local = mode === "local";
  const date = absolute(t + (local ? ahead(t, origin) : 0), origin, 0).slice(0, 10);
  return `${date} ${local ? Intl.DateTimeFormat().resolvedOptions().timeZone : "UTC"}`;
}

// A clock time as the page shows it ("13:45:02.5") on the day of the data, or null.
export function parseClock(text, origin) {
  const mode = modeOf(origin);
  if (mode === "start") return null;
  if (mode === "selection") {
    const t = /^-?[\d:. d]+$/.test(text.trim()) ? parseTime(text, origin) : null;
    return t === null || /^\s*\d{15,}\s*$/.test(text) ? null : since + t;
  }
  const m = /^(\d{1,2}):(\d{2})(?::(\d{2})(?:\.(\d{1,9}))?)?$/.exec(text.trim());
  if (!m) return null;
  const shift = mode === "local" ? ahead(0, origin) : 0;
  const local = origin + BigInt(Math.round(shift));
  const midnight = local - (((local % 86400000000000n) + 86400000000000n) % 86400000000000n);
  const s = (Number(m[1]) * 60 + Number(m[2])) * 60 + Number(m[3] ?? 0);
  let at = Number(midnight - local) + s * 1e9 + Number((m[4] ?? "").padEnd(9, "0"));
  // the day after, of what goes on past midnight
  if (at < -1e9) at += 86400e9;
  return at;
}
