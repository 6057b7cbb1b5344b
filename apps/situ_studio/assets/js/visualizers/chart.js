// Series of named numbers as bars, lines or areas, upright or lying. Names lie along one axis, values along the other:
// everything is drawn by place (along the names) and height (along the values).

import { theme } from "../page/theme.js";
import { number, tickCount, valueTicks } from "../page/number_text.js";

const PAD = 12,
  LINE = 16,
  MOST_NAME = 90;

// series: [{name, rows: [[label, value]], color}]; props: {kind, lying, x_title, y_title}
export function drawChart(ctx, { series, w, h, props }) {
  const kind = props.kind ?? "bars";
  const chart = kind === "xy" ? overX(series) : byName(series);
  const stacked = kind === "stacked" || kind === "area";
  const ends = extent(chart, stacked);
  const lying = props.lying === true;
  const box = frame(ctx, { chart, ends, w, h, lying, props, many: series.length > 1 });
  // along the names and along the values, to pixels of the box
  const along = lying ? [box.t, box.b] : [box.l, box.r];
  const up = lying ? [box.l, box.r] : [box.b, box.t];
  const place = (p) => along[0] + p * (along[1] - along[0]);
  const height = (v) => up[0] + ((v - ends[0]) / (ends[1] - ends[0] || 1)) * (up[1] - up[0]);
  const at = lying ? (p, v) => [height(v), place(p)] : (p, v) => [place(p), height(v)];
  axes(ctx, { chart, ends, box, place, height, lying });
  const scene = { ctx, chart, at, place };
  if (kind === "bars") bars(scene, (s, n) => [s / n, 1 / n]);
  else if (kind === "stacked") bars(scene, () => [0, 1], sums());
  else if (kind === "area") areas(scene);
  else lines(scene);
  titles(ctx, { series, box, w, h, lying, props });
}

// The values of each series by the names of all, in the order in which they come.
function byName(series) {
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

// The same where names are numbers: a place for each on a scale.
function overX(series) {
  const xs = series.flatMap((s) => s.rows.map(([x]) => Number(x))).filter(Number.isFinite);
  const lo = Math.min(...xs),
    hi = Math.max(...xs);
  const place = (x) => (hi > lo ? (x - lo) / (hi - lo) : 0.5);
  const at = hi > lo ? valueTicks(lo, hi, 6) : xs.slice(0, 1);
  return {
    names: at.map((x) => number(x, 4)),
    places: at.map(place),
    step: at.length > 1 ? place(at[1]) - place(at[0]) : 1,
    lines: series.map((s) => ({
      color: s.color,
      points: s.rows
        .map(([x, v]) => [place(Number(x)), v])
        .filter(([p]) => Number.isFinite(p))
        .sort(([a], [b]) => a - b),
    })),
  };
}

// How much has been stacked on either side of zero at each place.
function sums() {
  const held = new Map();
  return (p, v) => {
    const key = `${p} ${v < 0}`;
    const from = held.get(key) ?? 0;
    held.set(key, from + v);
    return from;
  };
}

// From the least to the greatest value, zero among them.
function extent({ lines }, stacked) {
  const from = stacked ? sums() : () => 0;
  const ends = lines.flatMap((l) => l.points.map(([p, v]) => from(p, v ?? 0) + (v ?? 0)));
  const lo = Math.min(0, ...ends);
  return [lo, Math.max(0, ...ends) || (lo < 0 ? 0 : 1)];
}

function frame(ctx, { chart, ends, w, h, lying, props, many }) {
  const wide = (texts) => Math.min(Math.max(0, ...texts.map((t) => ctx.measureText(t).width)), MOST_NAME);
  const values = valueTicks(...ends, tickCount(h)).map((v) => number(v, 4));
  const [below, beside] = lying ? [props.y_title, props.x_title] : [props.x_title, props.y_title];
  return {
    l: wide(lying ? chart.names : values) + PAD + 8 + (beside ? LINE : 0),
    t: PAD + (many ? LINE : 0),
    r: w - PAD,
    b: h - 26 - (below ? LINE : 0),
  };
}

function axes(ctx, { chart, ends, box, place, height, lying }) {
  const c = theme();
  const name = (text) => (text.length > 12 ? `${text.slice(0, 11)}…` : text);
  const room = lying ? box.r - box.l : box.b - box.t;
  for (const v of valueTicks(...ends, lying ? Math.max(2, Math.floor(room / 70)) : tickCount(room))) {
    const px = height(v);
    ctx.fillStyle = c.grid;
    if (lying) ctx.fillRect(Math.round(px), box.t, 1, box.b - box.t);
    else ctx.fillRect(box.l, Math.round(px), box.r - box.l, 1);
    ctx.fillStyle = c.axis;
    ctx.textAlign = lying ? "center" : "right";
    if (lying) ctx.fillText(number(v, 4), px, box.b + 16);
    else ctx.fillText(number(v, 4), box.l - 6, px + 4);
  }
  const step = Math.abs(place(chart.step) - place(0));
  const every = Math.max(1, Math.ceil((lying ? 14 : 48) / step));
  ctx.fillStyle = c.axis;
  chart.names.forEach((text, i) => {
    if (i % every) return;
    const px = place(chart.places[i]);
    ctx.textAlign = lying ? "right" : "center";
    if (lying) ctx.fillText(name(text), box.l - 6, px + 4);
    else ctx.fillText(name(text), px, box.b + 16);
  });
  ctx.textAlign = "left";
}

// share(nth, of) tells which part of a name's place a series has: [from, size].
function bars({ ctx, chart, at, place }, share, from = () => 0) {
  const px = Math.abs(place(chart.step) - place(0));
  const gap = Math.min(px * 0.2, 8) / px;
  chart.lines.forEach(({ color, points }, s) => {
    const [begin, size] = share(s, chart.lines.length);
    ctx.fillStyle = color;
    for (const [p, v] of points) {
      if (v === null) continue;
      const base = from(p, v);
      const left = p + chart.step * (gap / 2 - 0.5 + begin * (1 - gap));
      const [x0, y0] = at(left, base),
        [x1, y1] = at(left + chart.step * size * (1 - gap), base + v);
      ctx.fillRect(
        Math.min(x0, x1),
        Math.min(y0, y1),
        Math.max(Math.abs(x1 - x0), 1),
        Math.max(Math.abs(y1 - y0), 1),
      );
    }
  });
}

function lines({ ctx, chart, at }) {
  ctx.lineWidth = 1.5;
  ctx.lineJoin = "round";
  for (const { color, points } of chart.lines) {
    ctx.strokeStyle = ctx.fillStyle = color;
    ctx.beginPath();
    let pen = false;
    for (const [p, v] of points) {
      if (v === null) pen = false;
      else if (pen) ctx.lineTo(...at(p, v));
      else ctx.moveTo(...at(p, v));
      pen = v !== null;
    }
    ctx.stroke();
    ctx.beginPath();
    for (const [p, v] of points) {
      if (v === null) continue;
      const [x, y] = at(p, v);
      ctx.moveTo(x + 2, y);
      ctx.arc(x, y, 2, 0, 2 * Math.PI);
    }
    ctx.fill();
  }
}

function areas({ ctx, chart, at }) {
  const from = sums();
  for (const { color, points } of chart.lines) {
    const bases = points.map(([p, v]) => [p, from(p, v ?? 0), v ?? 0]);
    ctx.fillStyle = color;
    ctx.globalAlpha = 0.75;
    ctx.beginPath();
    bases.forEach(([p, base, v], i) => (i ? ctx.lineTo : ctx.moveTo).call(ctx, ...at(p, base + v)));
    for (const [p, base] of bases.slice().reverse()) ctx.lineTo(...at(p, base));
    ctx.closePath();
    ctx.fill();
    ctx.globalAlpha = 1;
  }
}

function titles(ctx, { series, box, w, h, lying, props }) {
  const c = theme();
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
