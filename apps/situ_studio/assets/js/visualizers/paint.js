// Draws one stream's window onto a plot. `x` and `y` map time and value to canvas pixels.

import { pixelColumns, strokeSpan } from "./columns.js";

const SPACING = 9;

// Draws a line: straight or stepped while there are fewer messages than pixels, else columns from min to max.
export function paintLine(
  ctx,
  s,
  view,
  x,
  y,
  { color, width = 1.25, step = false, joined = true, points = false, marker = "circle", size = 5, ratio = 1 },
) {
  const n = s.length;
  if (!n) return;
  const a = Math.max(s.indexAt(view[0]), 0);
  let b = s.indexAt(view[1]) + 1;
  b = Math.min(Math.max(b, a), n - 1);
  ctx.strokeStyle = color;
  ctx.fillStyle = color;
  ctx.lineWidth = width * ratio;
  ctx.lineJoin = "round";
  if (!s.raw) {
    paintColumns(ctx, s, a, b, view, x, y, { least: Math.max(Math.round(width * ratio), 1), step, joined });
    if (points) paintDots(ctx, s, a, b, x, y, (size / 2) * ratio, marker);
    return;
  }
  ctx.beginPath();
  // the first point of the current stroke, or -1
  let first = -1,
    py = 0;
  // a message between two gaps or missing values is drawn as a dot
  const endStroke = (last) => {
    if (first === last) {
      ctx.moveTo(x(s.t[last]) - ratio, py);
      ctx.lineTo(x(s.t[last]) + ratio, py);
    }
    first = -1;
  };
  for (let i = a; i <= b; i++) {
    const v = s.last[i];
    if (first >= 0 && (!Number.isFinite(v) || s.hasGapBefore(i))) endStroke(i - 1);
    if (!Number.isFinite(v)) continue;
    const px = x(s.t[i]),
      p = y(v);
    if (first < 0) {
      ctx.moveTo(px, p);
      first = i;
    } else {
      if (step) ctx.lineTo(px, py);
      ctx.lineTo(px, p);
    }
    py = p;
  }
  if (first >= 0) {
    if (step && b === n - 1) ctx.lineTo(stepEnd(s, b, view, x), py);
    endStroke(b);
  }
  if (joined) ctx.stroke();
  // dots mark single messages if they are far enough apart
  const apart = b > a ? (x(s.t[b]) - x(s.t[a])) / (b - a) : Infinity;
  if (points || apart > SPACING * ratio)
    paintDots(ctx, s, a, b, x, y, points ? (size / 2) * ratio : 1.75 * ratio, points ? marker : "circle");
}

// Draws opaque columns, so that a single outlier is visible at every zoom.
function paintColumns(ctx, s, a, b, view, x, y, { least, step = false, joined = true }) {
  const found = pixelColumns(s, a, b, x, Math.floor(x(view[0])), Math.ceil(x(view[1])));
  ctx.beginPath();
  for (let k = 0; k < found.lo.length; k++) {
    if (!(found.lo[k] <= found.hi[k])) continue;
    const [top, height] = strokeSpan(y(found.hi[k]), y(found.lo[k]), least);
    ctx.rect(found.left + k, top, 1, height);
  }
  ctx.fill();
  if (!joined) return;
  ctx.beginPath();
  for (const [c0, v0, c1, v1] of found.joins) {
    ctx.moveTo(c0 + 0.5, y(v0));
    if (step) ctx.lineTo(c1 + 0.5, y(v0));
    ctx.lineTo(c1 + 0.5, y(v1));
  }
  if (step && b === s.length - 1 && Number.isFinite(s.last[b])) {
    ctx.moveTo(x(s.t[b]), y(s.last[b]));
    ctx.lineTo(stepEnd(s, b, view, x), y(s.last[b]));
  }
  ctx.stroke();
}

// Returns the end of the last step: it lasts until the next message is due.
const stepEnd = (s, b, view, x) => Math.min(x(view[1]), x(s.t[b] + Math.min(s.gapThreshold(b), 1e15)));

// The outlines of markers; those that consist of strokes are stroked instead of filled.
const MARKERS = {
  circle: (ctx, x, y, r) => {
    ctx.moveTo(x + r, y);
    ctx.arc(x, y, r, 0, 2 * Math.PI);
  },
  square: (ctx, x, y, r) => ctx.rect(x - r, y - r, 2 * r, 2 * r),
  triangle: (ctx, x, y, r) => tracePolygon(ctx, [x, y - r], [x + r, y + r], [x - r, y + r]),
  diamond: (ctx, x, y, r) => tracePolygon(ctx, [x, y - r], [x + r, y], [x, y + r], [x - r, y]),
  plus: (ctx, x, y, r) => traceStrokes(ctx, [x - r, y, x + r, y], [x, y - r, x, y + r]),
  cross: (ctx, x, y, r) => traceStrokes(ctx, [x - r, y - r, x + r, y + r], [x - r, y + r, x + r, y - r]),
};

function tracePolygon(ctx, first, ...others) {
  ctx.moveTo(...first);
  for (const p of others) ctx.lineTo(...p);
  ctx.closePath();
}

function traceStrokes(ctx, ...lines) {
  for (const [a, b, c, d] of lines) {
    ctx.moveTo(a, b);
    ctx.lineTo(c, d);
  }
}

function paintDots(ctx, s, a, b, x, y, r, marker) {
  const outline = MARKERS[marker] ?? MARKERS.circle;
  ctx.beginPath();
  for (let i = a; i <= b; i++) {
    const v = s.last[i];
    if (!Number.isFinite(v)) continue;
    const px = x(s.t[i]),
      py = y(v);
    outline(ctx, px, py, r);
  }
  if (marker === "plus" || marker === "cross") ctx.stroke();
  else ctx.fill();
}

// Draws audio: columns of extremes, at least a pixel high so that silence is visible.
export function paintWave(ctx, s, view, x, y, { color, ratio = 1 }) {
  const n = s.length;
  if (!n) return;
  const a = Math.max(s.indexAt(view[0]), 0);
  const b = Math.min(s.indexAt(view[1]) + 1, n - 1);
  ctx.fillStyle = ctx.strokeStyle = color;
  ctx.lineWidth = ratio;
  paintColumns(ctx, s, a, b, view, x, y, { least: 1 });
}

// Draws latencies: a stem for each message, in the warning color above the threshold; negative ones point down.
export function paintStems(ctx, s, view, x, y, { color, warn, threshold, ratio = 1 }) {
  const n = s.length;
  if (!n) return;
  const a = Math.max(s.indexAt(view[0]), 0);
  const b = Math.min(s.indexAt(view[1]) + 1, n - 1);
  for (const over of [false, true]) {
    ctx.strokeStyle = over ? warn : color;
    ctx.lineWidth = 1.25 * ratio;
    ctx.beginPath();
    for (let i = a; i <= b; i++) {
      if (s.max[i] > threshold !== over) continue;
      const px = x(s.t[i]);
      ctx.moveTo(px, y(Math.min(s.min[i], 0)));
      ctx.lineTo(px, y(Math.max(s.max[i], 0)));
    }
    ctx.stroke();
  }
}

// Draws a bracket where a stream begins later or ends earlier than its recording. `ends`: {first, last} in ns of the
// page, either may be missing.
export function paintBrackets(ctx, ends, x, top, bottom, { color, ratio = 1 }) {
  const foot = 5 * ratio;
  ctx.strokeStyle = color;
  ctx.lineWidth = 1.5 * ratio;
  ctx.setLineDash([3 * ratio, 2 * ratio]);
  for (const [t, way] of [
    [ends.first, 1],
    [ends.last, -1],
  ]) {
    if (t == null) continue;
    const px = x(t);
    ctx.beginPath();
    ctx.moveTo(px + way * foot, top + ratio);
    ctx.lineTo(px, top + ratio);
    ctx.lineTo(px, bottom - ratio);
    ctx.lineTo(px + way * foot, bottom - ratio);
    ctx.stroke();
  }
  ctx.setLineDash([]);
}
