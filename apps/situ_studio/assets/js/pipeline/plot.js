// Plots the history of one statistic of the selected element, with its range and the value under the mouse.
import { themeColors, onTheme } from "../page/theme.js";

export class HistoryPlot {
  constructor(el) {
    this.el = el;
    this.unit = el.dataset.unit;
    this.rows = [];
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.note = el.appendChild(document.createElement("output"));
    this.el.addEventListener("pointermove", (e) => this.moveHover(e.offsetX));
    this.el.addEventListener("pointerleave", () => this.moveHover(null));
    this.resized = new ResizeObserver(() => this.draw());
    this.resized.observe(el);
    this.unsubscribe = onTheme(() => this.draw());
  }

  setRows(rows) {
    this.rows = rows;
    this.draw();
  }

  addRow(row, most = 1200) {
    this.rows.push(row);
    if (this.rows.length > most) this.rows.splice(0, this.rows.length - most);
    this.draw();
  }

  moveHover(x) {
    this.at = x;
    this.draw();
  }

  draw() {
    const ratio = devicePixelRatio || 1;
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h) return;
    this.canvas.width = w * ratio;
    this.canvas.height = h * ratio;
    const c = this.canvas.getContext("2d");
    c.scale(ratio, ratio);
    const colors = themeColors();
    const known = this.rows.filter(([, v]) => typeof v === "number");
    if (known.length === 0) return void (this.note.textContent = "–");
    const [t0, t1] = [known[0][0], known.at(-1)[0]];
    const values = known.map(([, v]) => v);
    const low = Math.min(0, ...values);
    const highest = Math.max(...values);
    const high = highest === low ? low + 1 : highest;
    const timeToX = (t) => 2 + ((t - t0) / Math.max(1, t1 - t0)) * (w - 4);
    const valueToY = (v) => h - 3 - ((v - low) / (high - low)) * (h - 8);
    c.strokeStyle = colors.grid;
    c.beginPath();
    c.moveTo(0, valueToY(low) + 0.5);
    c.lineTo(w, valueToY(low) + 0.5);
    c.stroke();
    c.beginPath();
    known.forEach(([t, v], i) => (i ? c.lineTo(timeToX(t), valueToY(v)) : c.moveTo(timeToX(t), valueToY(v))));
    c.strokeStyle = colors.accent;
    c.lineWidth = 1.4;
    c.stroke();
    c.lineTo(timeToX(t1), valueToY(low));
    c.lineTo(timeToX(t0), valueToY(low));
    c.globalAlpha = 0.14;
    c.fillStyle = colors.accent;
    c.fill();
    c.globalAlpha = 1;
    let shown = known.at(-1);
    if (this.at !== null && this.at !== undefined) {
      shown = known.reduce((best, row) =>
        Math.abs(timeToX(row[0]) - this.at) < Math.abs(timeToX(best[0]) - this.at) ? row : best,
      );
      c.fillStyle = colors.cursor;
      c.fillRect(timeToX(shown[0]) - 0.5, 0, 1, h);
    }
    const ago = Math.round((t1 - shown[0]) / 1000);
    const age = ago > 0 ? ` · ${ago} s ago` : "";
    this.note.textContent = `${formatStat(shown[1], this.unit)}${age} · max ${formatStat(high, this.unit)}`;
  }

  destroy() {
    this.resized.disconnect();
    this.unsubscribe();
  }
}

/** @type {[least: number, factor: number, letter: string][]} */
const SI = [
  [1e9, 1e9, "G"],
  [1e6, 1e6, "M"],
  [1e4, 1e3, "k"],
];

export function formatStat(value, unit) {
  if (unit === "ms" && value >= 1000) return `${(value / 1000).toPrecision(3)} s`;
  if (unit === "ms" && value > 0 && value < 0.1) return `${(value * 1000).toPrecision(3)} µs`;
  if (unit === "ms") return `${formatDigits(value)} ms`;
  if (unit === "percent") return `${formatDigits(value)} %`;
  const [, factor, letter] = SI.find(([least]) => value >= least) ?? [0, 1, ""];
  const scaled = value / factor;
  return `${formatDigits(scaled)} ${letter}${unit === "bytes" ? "B" : unit === "rate" ? "/s" : ""}`.trim();
}

const formatDigits = (v) =>
  Number.isInteger(v) ? String(v) : v >= 100 ? v.toFixed(0) : v >= 10 ? v.toFixed(1) : v.toFixed(2);
