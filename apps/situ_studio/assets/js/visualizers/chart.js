// Draws series of named numbers as bars, lines or areas, vertical or horizontal. Names are on one axis, values on
// the other: everything is drawn by position (along the names) and height (along the values).

import { themeColors } from "../page/theme.js";
import { formatNumber, tickCount, valueTicks } from "../page/number_text.js";

const PAD = 12,
  LINE = 16,
  MOST_NAME = 90;

// series: [{name, rows: [[label, value]], color}]; props: {kind, lying, x_title, y_title}
export function drawChart(ctx, { series, w, h, props }) {
  const kind = props.kind ?? "bars";
  const chart = kind === "xy" ? chartOverX(series) : chartByName(series);
  const stacked = kind === "stacked" || kind === "area";
  const ends = valueExtent(chart, stacked);
  const lying = props.lying === true;
  const box = plotBox(ctx, { chart, ends, w, h, lying, props, many: series.length > 1 });
  // pixel ranges of the names' and values' axes
  const along = lying ? [box.t, box.b] : [box.l, box.r];
  const up = lying ? [box.l, box.r] : [box.b, box.t];
  const namePosition = (p) => along[0] + p * (along[1] - along[0]);
  const valueHeight = (v) => up[0] + ((v - ends[0]) / (ends[1] - ends[0] || 1)) * (up[1] - up[0]);
  const pointAt = lying ? (p, v) => [valueHeight(v), namePosition(p)] : (p, v) => [namePosition(p), valueHeight(v)];
  drawAxes(ctx, { chart, ends, box, namePosition, valueHeight, lying });
  const scene = { ctx, chart, pointAt, namePosition };
  if (kind === "bars") drawBars(scene, (s, n) => [s / n, 1 / n]);
  else if (kind === "stacked") drawBars(scene, () => [0, 1], stackSums());
  else if (kind === "area") drawAreas(scene);
  else drawLines(scene);
  drawTitles(ctx, { series, box, w, h, lying, props });
}

// Arranges the values of each series by the names of all series, in order of appearance.
function chartByName(series) {
  const names = [...new Set(series.flatMap((s) => s.rows.map(([label]) => label)))];
  const n = names.length;
  return {
    names,
    places: names.map((_, i) => (i + 0.5) / n),
    step: 1 / n,
    lines: series.map((s) => {
      const values = new Map(s.rows);
      return { color: s.color, points: names.map((name, i) => [(i + 0.5) / n, values.get(name) ?? null]) };
    }),
  };
}

// Arranges the values by names that are numbers, at their positions on a scale.
function chartOverX(series) {
  const xs = series.flatMap((s) => s.rows.map(([x]) => Number(x))).filter(Number.isFinite);
  const lo = Math.min(...xs),
    hi = Math.max(...xs);
  const scalePosition = (x) => (hi > lo ? (x - lo) / (hi - lo) : 0.5);
  const ticks = hi > lo ? valueTicks(lo, hi, 6) : xs.slice(0, 1);
  return {
    names: ticks.map((x) => formatNumber(x, 4)),
    places: ticks.map(scalePosition),
    step: ticks.length > 1 ? scalePosition(ticks[1]) - scalePosition(ticks[0]) : 1,
    lines: series.map((s) => ({
      color: s.color,
      points: s.rows
        .map(([x, v]) => [scalePosition(Number(x)), v])
        .filter(([p]) => Number.isFinite(p))
        .sort(([a], [b]) => a - b),
    })),
  };
}

// Returns a function that stacks values at each position on either side of zero.
function stackSums() {
  const held = new Map();
  return (p, v) => {
    const key = `${p} ${v < 0}`;
    const from = held.get(key) ?? 0;
    held.set(key, from + v);
    return from;
  };
}

// Returns the range of the values, including zero.
function valueExtent({ lines }, stacked) {
  const from = stacked ? stackSums() : () => 0;
  const ends = lines.flatMap((l) => l.points.map(([p, v]) => from(p, v ?? 0) + (v ?? 0)));
  const lo = Math.min(0, ...ends);
  return [lo, Math.max(0, ...ends) || (lo < 0 ? 0 : 1)];
}

function plotBox(ctx, { chart, ends, w, h, lying, props, many }) {
  const textRoom = (texts) => Math.min(Math.max(0, ...texts.map((t) => ctx.measureText(t).width)), MOST_NAME);
  const values = valueTicks(...ends, tickCount(h)).map((v) => formatNumber(v, 4));
  const [below, beside] = lying ? [props.y_title, props.x_title] : [props.x_title, props.y_title];
  return {
    l: textRoom(lying ? chart.names : values) + PAD + 8 + (beside ? LINE : 0),
    t: PAD + (many ? LINE : 0),
    r: w - PAD,
    b: h - 26 - (below ? LINE : 0),
  };
}

function drawAxes(ctx, { chart, ends, box, namePosition, valueHeight, lying }) {
  const c = themeColors();
  const shortName = (text) => (text.length > 12 ? `${text.slice(0, 11)}…` : text);
  const room = lying ? box.r - box.l : box.b - box.t;
  for (const v of valueTicks(...ends, lying ? Math.max(2, Math.floor(room / 70)) : tickCount(room))) {
    const px = valueHeight(v);
    ctx.fillStyle = c.grid;
    if (lying) ctx.fillRect(Math.round(px), box.t, 1, box.b - box.t);
    else ctx.fillRect(box.l, Math.round(px), box.r - box.l, 1);
    ctx.fillStyle = c.axis;
    ctx.textAlign = lying ? "center" : "right";
    if (lying) ctx.fillText(formatNumber(v, 4), px, box.b + 16);
    else ctx.fillText(formatNumber(v, 4), box.l - 6, px + 4);
  }
  const step = Math.abs(namePosition(chart.step) - namePosition(0));
  const every = Math.max(1, Math.ceil((lying ? 14 : 48) / step));
  ctx.fillStyle = c.axis;
  chart.names.forEach((text, i) => {
    if (i % every) return;
    const px = namePosition(chart.places[i]);
    ctx.textAlign = lying ? "right" : "center";
    if (lying) ctx.fillText(shortName(text), box.l - 6, px + 4);
    else ctx.fillText(shortName(text), px, box.b + 16);
  });
  ctx.textAlign = "left";
}

// share(nth, of) returns the part of a name's width that a series occupies: [from, size].
/** @param {any} scene @param {Function} share @param {(place: number, value: number) => number} from */
function drawBars({ ctx, chart, pointAt, namePosition }, share, from = () => 0) {
  const px = Math.abs(namePosition(chart.step) - namePosition(0));
  const gap = Math.min(px * 0.2, 8) / px;
  chart.lines.forEach(({ color, points }, s) => {
    const [begin, size] = share(s, chart.lines.length);
    ctx.fillStyle = color;
    for (const [p, v] of points) {
      if (v === null) continue;
      const base = from(p, v);
      const left = p + chart.step * (gap / 2 - 0.5 + begin * (1 - gap));
      const [x0, y0] = pointAt(left, base),
        [x1, y1] = pointAt(left + chart.step * size * (1 - gap), base + v);
      ctx.fillRect(
        Math.min(x0, x1),
        Math.min(y0, y1),
        Math.max(Math.abs(x1 - x0), 1),
        Math.max(Math.abs(y1 - y0), 1),
      );
    }
  });
}

function drawLines({ ctx, chart, pointAt }) {
  ctx.lineWidth = 1.5;
  ctx.lineJoin = "round";
  for (const { color, points } of chart.lines) {
    ctx.strokeStyle = ctx.fillStyle = color;
    ctx.beginPath();
    let pen = false;
    for (const [p, v] of points) {
      if (v === null) pen = false;
      else if (pen) ctx.lineTo(...pointAt(p, v));
      else ctx.moveTo(...pointAt(p, v));
      pen = v !== null;
    }
    ctx.stroke();
    ctx.beginPath();
    for (const [p, v] of points) {
      if (v === null) continue;
      const [x, y] = pointAt(p, v);
      ctx.moveTo(x + 2, y);
      ctx.arc(x, y, 2, 0, 2 * Math.PI);
    }
    ctx.fill();
  }
}

function drawAreas({ ctx, chart, pointAt }) {
  const from = stackSums();
  for (const { color, points } of chart.lines) {
    const bases = points.map(([p, v]) => [p, from(p, v ?? 0), v ?? 0]);
    ctx.fillStyle = color;
    ctx.globalAlpha = 0.75;
    ctx.beginPath();
    bases.forEach(([p, base, v], i) => (i ? ctx.lineTo : ctx.moveTo).call(ctx, ...pointAt(p, base + v)));
    for (const [p, base] of bases.slice().reverse()) ctx.lineTo(...pointAt(p, base));
    ctx.closePath();
    ctx.fill();
    ctx.globalAlpha = 1;
  }
}

function drawTitles(ctx, { series, box, w, h, lying, props }) {
  const c = themeColors();
  const [below, beside] = lying ? [props.y_title, props.x_title] : [props.x_title, props.y_title];
  ctx.fillStyle = c.axis;
  ctx.textAlign = "center";
  if (below) ctx.fillText(below, (box.l + box.r) / 2, h - 6);
  if (beside) {
    ctx.save();
    ctx.translate(12, (box.t + box.b) / 2);
    ctx.rotate(-Math.PI / 2);
    ctx.fillText(beside, 0, 4);
    ctx.restore();
  }
  ctx.textAlign = "left";
  if (series.length < 2) return;
  let x = box.l;
  for (const { name, color } of series) {
    const width = ctx.measureText(name).width + 24;
    if (x + width > w - PAD) break;
    ctx.fillStyle = color;
    ctx.fillRect(x, 9, 9, 3);
    ctx.fillStyle = c.axis;
    ctx.fillText(name, x + 14, 14);
    x += width;
  }
}
