// Draws rectangles, points, lines and texts over an image, and describes those under the mouse.

import { KIND } from "../data/frames.js";
import { FONT, readableColor, seriesColor } from "../page/theme.js";
import { formatNumber } from "../page/number_text.js";

// How far from a point the mouse may be, in screen pixels.
const NEAR = 5;
const MANY = 100;

// Converts between image and canvas pixels; `fit` is {x, y, k, width}.
export function imageMapping(fit, mirrored) {
  const { x, y, k, width } = fit;
  return {
    k,
    x: (v) => x + (mirrored ? width - v : v) * k,
    y: (v) => y + v * k,
    back: (px, py) => [mirrored ? width - (px - x) / k : (px - x) / k, (py - y) / k],
  };
}

export const shapes = {
  id: "shapes",
  panel: "image",

  acceptFrame(layer, frame, changed) {
    layer.error = frame.kind === KIND.error ? frame.message : null;
    layer.shapes = frame.kind === KIND.json ? frame.value : null;
    changed();
  },

  restyle() {},
  close() {},

  draw(ctx, layer, { map }) {
    if (layer.shapes) drawShapes(ctx, layer, map);
  },

  describeAt: (layer, x, y, k) => (layer.shapes ? shapesAt(layer.shapes, x, y, k) : []),
};

export function drawShapes(ctx, { shapes: s, vis, index }, map) {
  const props = vis.props ?? {};
  const own = vis.color ?? index;
  ctx.font = FONT;
  ctx.lineWidth = props.width ?? 2;
  for (const past of s.trail ?? []) drawTrail(ctx, past, (id) => seriesColor(props.color, id ?? own), map);
  (s.rects ?? []).forEach(([x, y, w, h, label, score, id], i) => {
    const color = seriesColor(props.color, Number.isInteger(id) ? id : own + i);
    const left = Math.min(map.x(x), map.x(x + w));
    ctx.strokeStyle = color;
    ctx.strokeRect(left, map.y(y), w * map.k, h * map.k);
    const track = Number.isInteger(id) ? String(id) : null;
    const joinParts = (parts, between) => parts.filter((p) => p != null && p !== "").join(between);
    const text = joinParts([joinParts([label, track], " "), score == null ? null : formatNumber(score, 2)], " · ");
    if (text && props.labels !== false) drawTag(ctx, text, left - 1, map.y(y), color);
  });
  const color = seriesColor(props.color, own);
  ctx.strokeStyle = ctx.fillStyle = color;
  ctx.beginPath();
  for (const [a, b, c, d] of s.lines ?? []) {
    ctx.moveTo(map.x(a), map.y(b));
    ctx.lineTo(map.x(c), map.y(d));
  }
  ctx.stroke();
  const r = props.radius ?? ((s.points?.length ?? 0) > MANY ? 1.2 : 3);
  ctx.beginPath();
  for (const [x, y] of s.points ?? []) {
    ctx.moveTo(map.x(x) + r, map.y(y));
    ctx.arc(map.x(x), map.y(y), r, 0, 2 * Math.PI);
  }
  ctx.fill();
  if (props.labels !== false) {
    for (const [x, y, label] of s.points ?? []) if (label) drawTag(ctx, label, map.x(x) + 5, map.y(y), color);
  }
  (s.texts ?? []).forEach((text, i) => drawTag(ctx, text, map.x(0) + 8, map.y(0) + 26 + 22 * i, color));
}

// Draws where objects were before: the older, the paler.
function drawTrail(ctx, [age, points, lines], color, map) {
  ctx.globalAlpha = 0.15 + 0.65 * (1 - age);
  for (const [x, y, id] of points) {
    ctx.fillStyle = color(id);
    ctx.beginPath();
    ctx.arc(map.x(x), map.y(y), 1.5, 0, 2 * Math.PI);
    ctx.fill();
  }
  ctx.strokeStyle = color(null);
  ctx.beginPath();
  for (const [a, b, c, d] of lines) {
    ctx.moveTo(map.x(a), map.y(b));
    ctx.lineTo(map.x(c), map.y(d));
  }
  ctx.stroke();
  ctx.globalAlpha = 1;
}

export function drawTag(ctx, text, left, y, color) {
  const w = ctx.measureText(text).width + 10;
  const x = Math.max(Math.min(left, (ctx.canvas?.clientWidth || Infinity) - w), Math.min(left, 0));
  const top = Math.max(y - 17, 0);
  ctx.fillStyle = color;
  ctx.fillRect(x, top, w, 17);
  ctx.fillStyle = readableColor(color);
  ctx.textBaseline = "middle";
  ctx.fillText(text, x + 5, top + 9);
  ctx.textBaseline = "alphabetic";
}

// Describes the shapes at a position of the image: the nearest point, and the smallest rectangle around it. `k` is
// screen pixels per image pixel. Returns no lines if there is nothing.
export function shapesAt({ points = [], rects = [] }, x, y, k) {
  return [...pointAt(points, x, y, NEAR / k), ...rectAt(rects, x, y)];
}

function pointAt(points, x, y, within) {
  let best = null,
    nearest = within;
  for (const p of points) {
    const d = Math.hypot(p[0] - x, p[1] - y);
    if (d <= nearest) [best, nearest] = [p, d];
  }
  return best ? [`${best[2] || "point"}  (${formatNumber(best[0], 4)}, ${formatNumber(best[1], 4)})`] : [];
}

function rectAt(rects, x, y) {
  const around = rects.filter(([l, t, w, h]) => x >= l && x <= l + w && y >= t && y <= t + h);
  if (!around.length) return [];
  const [l, t, w, h, label, score, id] = around.reduce((a, b) => (b[2] * b[3] < a[2] * a[3] ? b : a));
  const lines = [label || "rectangle"];
  if (score != null) lines.push(`score ${formatNumber(score, 4)}`);
  if (id != null) lines.push(`id ${id}`);
  lines.push(`${formatNumber(w, 4)} × ${formatNumber(h, 4)} at (${formatNumber(l, 4)}, ${formatNumber(t, 4)})`);
  return lines;
}
