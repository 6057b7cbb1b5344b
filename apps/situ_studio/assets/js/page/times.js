// Formats the times in lists and properties, which the server writes as UTC, as local times if the settings say so.

import { onSetting, readSetting } from "./settings.js";
import { isCalendarDate, formatRelative } from "../time/text.js";

const padNumber = (n, w = 2) => String(n).padStart(w, "0");

// `part` is "date", "time" (of day), "both", or "all" with milliseconds.
export function clockText(ns, part, local) {
  if (!isCalendarDate(BigInt(ns))) return part === "date" ? "no date" : `${formatRelative(Number(ns))} from 0`;
  const d = new Date(Number(BigInt(ns) / 1000000n));
  if (Number.isNaN(d.getTime())) return ns;
  const readPart = (name) => d[`get${local ? "" : "UTC"}${name}`]();
  const month = padNumber(readPart("Month") + 1);
  const date = `${padNumber(readPart("FullYear"), 4)}-${month}-${padNumber(readPart("Date"))}`;
  if (part === "date") return date;
  const seconds = `${padNumber(readPart("Hours"))}:${padNumber(readPart("Minutes"))}:${padNumber(readPart("Seconds"))}`;
  const time = part === "all" ? `${seconds}.${padNumber(readPart("Milliseconds"), 3)}` : seconds;
  return `${part === "time" ? "" : `${date} `}${time}${local ? "" : " UTC"}`;
}

export function showTimes(root = document) {
  const local = readSetting("clock") === "local";
  /** @type {NodeListOf<HTMLTimeElement>} */
  const times = root.querySelectorAll("time[data-ns]");
  for (const el of times) {
    const { ns, part } = el.dataset;
    const text = clockText(ns, part, local);
    if (el.textContent !== text) el.textContent = text;
    el.title = clockText(ns, "all", !local) + (local ? "" : " here");
  }
}

onSetting((id) => id === "clock" && showTimes());
