// Shows the statistics of a selection in a table.

import { formatNumber } from "./number_text.js";
import { formatDuration } from "../time/text.js";

const TITLES = {
  at_start: "at the start",
  at_end: "at the end",
  change: "change",
  slope_per_s: "change per second",
  n: "messages",
  rate_hz: "rate",
  period_ns: "typical pause",
  jitter_ns: "jitter (sd of pauses)",
  longest_pause_ns: "longest pause",
  gaps: "gaps (3 typical pauses)",
  mean: "mean",
  sd: "standard deviation",
  min: "least",
  p1: "1 %",
  p5: "5 %",
  p25: "25 %",
  median: "median",
  p75: "75 %",
  p95: "95 %",
  p99: "99 %",
  max: "greatest",
};

const formatStatistic = (name, v) =>
  name.endsWith("_ns") ? formatDuration(v) : name === "rate_hz" ? `${formatNumber(v, 4)} /s` : formatPlain(name, v);

// Values of messages are shown in full, computed values with ten digits.
const formatPlain = (name, v) =>
  !Number.isFinite(v) || ["mean", "sd", "change", "slope_per_s"].includes(name) ? formatNumber(v, 10) : String(v);

// rows: [{name, all, values: [[name, value], ...], error?}]
export function showStatistics(rows, length) {
  const dialog = document.body.appendChild(document.createElement("dialog"));
  dialog.id = "statistics";
  dialog.appendChild(document.createElement("h3")).textContent = `Selection, ${formatDuration(length)}`;
  const table = dialog.appendChild(document.createElement("table"));
  const addRow = (head, cells, tag) => {
    const tr = table.appendChild(document.createElement("tr"));
    tr.appendChild(document.createElement("th")).textContent = head;
    for (const c of cells) tr.appendChild(document.createElement(tag)).textContent = c;
  };
  addRow(
    "",
    rows.map((r) => r.name + (r.error ? ` (${r.error})` : r.all === false ? " (the first 2 million messages)" : "")),
    "th",
  );
  for (const [name, title] of Object.entries(TITLES)) {
    const cells = rows.map((r) => r.values.find(([n]) => n === name)?.[1]);
    if (cells.some((v) => v !== undefined))
      addRow(
        title,
        cells.map((v) => (v === undefined ? "" : formatStatistic(name, v))),
        "td",
      );
  }
  for (const r of rows) if (r.histogram) dialog.appendChild(buildHistogram(r));
  dialog.addEventListener("close", () => dialog.remove());
  dialog.addEventListener("click", (e) => e.target === dialog && dialog.close());
  dialog.showModal();
}

const SVG = "http://www.w3.org/2000/svg";

// Draws a bar for each bin of the histogram.
function buildHistogram({ name, histogram: { from, to, counts } }) {
  const figure = document.createElement("figure");
  const most = Math.max(...counts);
  const svg = figure.appendChild(document.createElementNS(SVG, "svg"));
  svg.setAttribute("viewBox", `0 0 ${counts.length * 8} 60`);
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", `Histogram of ${name} from ${formatNumber(from, 4)} to ${formatNumber(to, 4)}`);
  counts.forEach((n, i) => {
    const bar = svg.appendChild(document.createElementNS(SVG, "rect"));
    const h = (n / most) * 58;
    for (const [k, v] of Object.entries({ x: i * 8, y: 60 - h, width: 7, height: h })) bar.setAttribute(k, String(v));
    bar.appendChild(document.createElementNS(SVG, "title")).textContent = String(n);
  });
  const caption = figure.appendChild(document.createElement("figcaption"));
  for (const text of [formatNumber(from, 4), name, formatNumber(to, 4)])
    caption.appendChild(document.createElement("span")).textContent = text;
  return figure;
}
