// Times in lists and among properties, which the server writes as UTC: local where the settings say so.

import { onSetting, setting } from "./settings.js";
import { dated, relative } from "../time/text.js";

const pad = (n, w = 2) => String(n).padStart(w, "0");

// `part`: "date", "time" (of day), "both", or "all", which has milliseconds.
export function clockText(ns, part, local) {
  if (!dated(BigInt(ns))) return part === "date" ? "no date" : `${relative(Number(ns))} from 0`;
  const d = new Date(Number(BigInt(ns) / 1000000n));
  if (Number.isNaN(d.getTime())) return ns;
  const get = (name) => d[`get${local ? "" : "UTC"}${name}`]();
  const date = `${pad(get("FullYear"), 4)}-${pad(get("Month") + 1)}-${pad(get("Date"))}`;
  if (part === "date") return date;
  const seconds = `${pad(get("Hours"))}:${pad(get("Minutes"))}:${pad(get("Seconds"))}`;
  const time = part === "all" ? `${seconds}.${pad(get("Milliseconds"), 3)}` : seconds;
  return `${part === "time" ? "" : `${date} `}${time}${local ? "" : " UTC"}`;
}

export function tellTimes(root = document) {
  const local = setting("clock") === "local";
  for (const el of root.querySelectorAll("time[data-ns]")) {
    const { ns, part } = el.dataset;
    const text = clockText(ns, part, local);
    if (el.textContent !== text) el.textContent = text;
    el.title = clockText(ns, "all", !local) + (local ? "" : " here");
  }
}

onSetting((id) => id === "clock" && tellTimes());
