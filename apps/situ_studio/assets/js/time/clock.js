// Formats all times of the page in the same mode: UTC, local time, since the start of the data, or since the start
// of the selection.

import { formatAbsolute, isCalendarDate, parseTime, formatRelative, timeTicks } from "./text.js";
import { changeSetting, onSetting, readSetting } from "../page/settings.js";

export const MODES = [
  ["utc", "UTC"],
  ["local", "local"],
  ["start", "since start"],
  ["selection", "since selection"],
];

// The width of a letter of the ruler in pixels, and the space between two labels.
const LETTER = 6.6,
  BETWEEN = 16;

let chosen = readSetting("clock");
// The start of the selection, or of the data if nothing is selected.
let since = 0;
const listeners = new Set();

onSetting((id, value) => {
  if (id !== "clock") return;
  chosen = value;
  for (const l of listeners) l(chosen);
});

export const clockMode = () => chosen;

// Returns the mode for an origin. Times that are not calendar dates are shown since the start.
const clockModeFor = (origin) =>
  chosen !== "selection" && (origin === null || !isCalendarDate(origin)) ? "start" : chosen;

export function nextClock() {
  const i = MODES.findIndex(([m]) => m === chosen);
  changeSetting("clock", MODES[(i + 1) % MODES.length][0]);
}

export function onClock(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

// Sets the start of the selection; returns true if shown times change.
export function setSelectionStart(t) {
  const next = t ?? 0;
  if (next === since) return false;
  since = next;
  return chosen === "selection";
}

// Returns the offset of local time from UTC in ns.
function utcOffset(t, origin) {
  const ms = Number((origin + BigInt(Math.round(t))) / 1000000n);
  return -new Date(ms).getTimezoneOffset() * 60e9;
}

// Formats a time of the page; `unit` is the required precision, such as the unit of the ruler's ticks.
export function formatClock(t, origin, unit = 1e6) {
  const mode = clockModeFor(origin);
  if (mode === "selection") return formatRelative(t - since, unit);
  if (mode === "start") return formatRelative(t, unit);
  const decimals = unit >= 1e9 ? 0 : unit >= 1e6 ? 3 : unit >= 1e3 ? 6 : 9;
  const text = formatAbsolute(t + (mode === "local" ? utcOffset(t, origin) : 0), origin, decimals);
  return unit >= 86400e9 ? text.slice(0, 10) : text.slice(11);
}

// Returns the zero point of the ruler's units, so that round times have round labels.
function rulerZero(origin) {
  const mode = clockModeFor(origin);
  if (mode === "selection") return () => since;
  if (mode === "start") return () => 0;
  return (unit) => {
    const clock = origin + (mode === "local" ? BigInt(utcOffset(0, origin)) : 0n);
    return -Number(clock % BigInt(unit));
  };
}

// Returns the ticks of a ruler of `px` pixels, with enough space for their labels.
export function rulerTicks(view, px, origin, minPx = 90) {
  const found = timeTicks(view, px, minPx, rulerZero(origin));
  const name = formatClock(found.at[0] ?? view[0], origin, found.unit);
  const need = name.length * LETTER + BETWEEN;
  return need > minPx ? timeTicks(view, px, need, rulerZero(origin)) : found;
}

// Returns the date and time zone for a caption.
export function formatDay(t, origin) {
  const mode = clockModeFor(origin);
  if (mode === "selection") return "since selection";
  if (mode === "start") return "since start";
  const local = mode === "local";
  const date = formatAbsolute(t + (local ? utcOffset(t, origin) : 0), origin, 0).slice(0, 10);
  return `${date} ${local ? Intl.DateTimeFormat().resolvedOptions().timeZone : "UTC"}`;
}

// Parses a clock time as shown on the page ("13:45:02.5") on the day of the data; returns null if it is not one.
export function parseClock(text, origin) {
  const mode = clockModeFor(origin);
  if (mode === "start") return null;
  if (mode === "selection") {
    const t = /^-?[\d:. d]+$/.test(text.trim()) ? parseTime(text, origin) : null;
    return t === null || /^\s*\d{15,}\s*$/.test(text) ? null : since + t;
  }
  const m = /^(\d{1,2}):(\d{2})(?::(\d{2})(?:\.(\d{1,9}))?)?$/.exec(text.trim());
  if (!m) return null;
  const shift = mode === "local" ? utcOffset(0, origin) : 0;
  const local = origin + BigInt(Math.round(shift));
  const midnight = local - (((local % 86400000000000n) + 86400000000000n) % 86400000000000n);
  const s = (Number(m[1]) * 60 + Number(m[2])) * 60 + Number(m[3] ?? 0);
  let at = Number(midnight - local) + s * 1e9 + Number((m[4] ?? "").padEnd(9, "0"));
  // the next day, for data that continue past midnight
  if (at < -1e9) at += 86400e9;
  return at;
}
